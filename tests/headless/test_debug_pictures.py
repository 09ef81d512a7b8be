"""Debug layers as pictures: every layer beyond the contract's, in colours that can be told apart."""

import numpy as np
import OpenImageIO as oiio

from lumigate.core.layers import Layers, read_exr
from lumigate.headless.cli import main
from lumigate.headless.debug_pictures import id_colours, share_colours, write_debug_pictures


def test_fuzzy_clustering_shows_its_clusters(tmp_path):
    small = ["--size", "32x24", "--vpls", "64", "--pixel-samples", "1", "--bounces", "1"]
    options = ["--method", "fuzzy-clustering", "--vpl-clusters", "16", "--point-clusters", "40", "--fuzziness", "4", "--debug-layers"]
    assert main(["render", "cornell", "-o", str(tmp_path / "out.exr"), *small, *options]) == 0
    layers = read_exr(tmp_path / "out.exr")
    wanted = {"PointClusters", "PointRepresentatives", "FuzzyWeights0", "FuzzyWeights1", "VisibleShare", "VisibleShareBlended"}
    assert wanted <= set(layers)
    for name in wanted:
        image = oiio.ImageBuf(str(tmp_path / f"out-{name}.png"))
        assert (image.spec().width, image.spec().height) == (32, 24)
    colours = oiio.ImageBuf(str(tmp_path / "out-PointClusters.png")).get_pixels(oiio.UINT8).reshape(-1, 3)
    ids = layers["PointClusters"].ravel()
    assert len(np.unique(colours, axis=0)) == len(np.unique(ids))


def test_pictures_of_the_contract_are_not_debug_pictures(tmp_path):
    assert main(["render", "cornell", "-o", str(tmp_path / "out.exr"), "--size", "16x12", "--vpls", "8", "--pixel-samples", "1"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out.exr"]


def test_layers_of_light_groups_are_not_debug_pictures(tmp_path):
    # Three pictures a group and frame that nobody had asked for, and a fault where a group's name was none of a file.
    layers = Layers({"Combined": np.ones((2, 2, 3)), "Direct_Key": np.ones((2, 2, 3)), "Combined_Key/Fill": np.ones((2, 2, 3))})
    assert write_debug_pictures(tmp_path / "out.exr", layers) == []
    assert not list(tmp_path.iterdir())


def test_colours_of_numbers_and_shares():
    colours = id_colours(np.arange(200).reshape(10, 20))
    assert not colours[0, 0].any()
    assert len(np.unique((colours.reshape(-1, 3) * 255).round().astype(int), axis=0)) == 200
    shares = share_colours(np.array([[0.0, 0.5, 1.0]]))
    assert (np.diff(shares @ [0.2126, 0.7152, 0.0722]) > 0).all()
