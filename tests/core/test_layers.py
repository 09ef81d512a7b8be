"""Layers and their files: round trips, names, whole files or none, Blender's own files, previews."""

import subprocess
import sys
import textwrap

import numpy as np
import OpenImageIO as oiio
import pytest

from lumigate.core import layers as lay
from lumigate.core.errors import SceneError


def some_layers(height=5, width=7, view_layer="ViewLayer"):
    rng = np.random.default_rng(3)
    layers = lay.Layers(view_layer=view_layer, metadata={"method": "auto"})
    for name in ("Combined", "DiffuseIndirect", "Normal", "Position", "VPL 12"):
        layers[name] = rng.normal(size=(height, width, 3)) * 1e3
    layers["Depth"] = rng.random((height, width))
    return layers


@pytest.mark.parametrize("view_layer", ["ViewLayer", "View Layer.001"])
def test_exr_round_trip_keeps_every_bit(tmp_path, view_layer):
    written = some_layers(view_layer=view_layer)
    read = lay.read_exr(lay.write_exr(tmp_path / "new folder" / "a.exr", written))
    assert set(read) == set(written)
    assert read.view_layer == view_layer
    assert read.metadata["method"] == "auto"
    assert read.full_size is None
    for name, array in written.items():
        np.testing.assert_array_equal(read[name], array)


def test_channel_names_are_the_contract(tmp_path):
    path = lay.write_exr(tmp_path / "a.exr", some_layers())
    spec = oiio.ImageInput.open(str(path)).spec()
    assert {"ViewLayer.DiffuseIndirect.R", "ViewLayer.Normal.Z", "ViewLayer.Position.X", "ViewLayer.Depth.V"} <= set(spec.channelnames)
    assert spec.format == oiio.FLOAT
    assert spec.getattribute("oiio:subimages") == 1


def test_first_row_is_the_top(tmp_path):
    image = np.zeros((4, 3, 3))
    image[0] = 1
    path = lay.write_exr(tmp_path / "a.exr", lay.Layers({"Combined": image}))
    assert oiio.ImageInput.open(str(path)).read_scanline(0, 0, oiio.FLOAT).min() == 1


def test_border_is_a_data_window(tmp_path):
    layers = some_layers()
    layers.offset, layers.full_size = (10, 20), (64, 48)
    read = lay.read_exr(lay.write_exr(tmp_path / "a.exr", layers))
    assert (read.offset, read.full_size, read.size) == ((10, 20), (64, 48), (7, 5))


def test_infinite_and_nan_survive(tmp_path):
    image = np.array([[[np.nan, np.inf, -np.inf]]], np.float32)
    read = lay.read_exr(lay.write_exr(tmp_path / "a.exr", lay.Layers({"Combined": image})))
    np.testing.assert_array_equal(read["Combined"], image)


def test_layers_of_different_size_are_refused():
    layers = some_layers()
    with pytest.raises(ValueError, match="Albedo"):
        layers["Albedo"] = np.zeros((2, 2, 3))
    with pytest.raises(ValueError, match="Flat"):
        layers["Flat"] = np.zeros(3)


def write_parts(path, parts):
    """A file of several parts, each (channel names, pixels)."""
    specs = []
    for i, (names, pixels) in enumerate(parts):
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], len(names), oiio.FLOAT)
        spec.channelnames = names
        spec.attribute("name", f"part{i}")
        specs.append(spec)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), tuple(specs))
    for i, (_, pixels) in enumerate(parts):
        assert i == 0 or output.open(str(path), specs[i], "AppendSubimage")
        assert output.write_image(pixels)
    output.close()


def test_reads_blenders_files_of_several_parts_and_view_layers(tmp_path):
    rng = np.random.default_rng(1)
    combined, indirect, depth, other = (rng.random((3, 4, c), dtype=np.float32) for c in (4, 3, 1, 3))
    path = tmp_path / "parts.exr"
    rgb = ("R", "G", "B")
    write_parts(
        path,
        [
            (tuple(f"ViewLayer.Combined.{c}" for c in "RGBA"), combined),
            (tuple(f"ViewLayer.Diffuse Indirect.{c}" for c in rgb), indirect),
            (("ViewLayer.Depth.Z",), depth),
            (tuple(f"Second.DiffInd.{c}" for c in rgb), other),
        ],
    )
    read = lay.read_exr(path)
    assert read.view_layer == "ViewLayer"
    assert list(read) == ["Combined", "Diffuse Indirect", "Depth"]
    for name, array in {"Combined": combined, "Diffuse Indirect": indirect, "Depth": depth}.items():
        np.testing.assert_array_equal(read[name], array)
    np.testing.assert_array_equal(lay.read_exr(path, "Second")["DiffInd"], other)
    with pytest.raises(SceneError, match=r"Third.*ViewLayer"):
        lay.read_exr(path, "Third")


def test_what_is_no_image_is_one_line(tmp_path):
    with pytest.raises(SceneError, match="does not exist"):
        lay.read_exr(tmp_path / "none.exr")
    (tmp_path / "text.exr").write_text("no image")
    with pytest.raises(SceneError, match=r"text\.exr") as caught:
        lay.read_exr(tmp_path / "text.exr")
    assert "\n" not in str(caught.value)


def test_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    path = lay.write_exr(tmp_path / "a.exr", some_layers())
    before = path.read_bytes()

    def fail(temporary):
        temporary.write_bytes(b"half")
        raise OSError("No space left\non device")

    with pytest.raises(SceneError, match=r"cannot write .*a\.exr: No space left on device"):
        lay.write_whole(path, fail)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


def test_cancelled_write_leaves_nothing(tmp_path):
    def cancel(temporary):
        temporary.write_bytes(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        lay.write_whole(tmp_path / "a.exr", cancel)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError, match="cannot write"):
        lay.write_exr(tmp_path / "file" / "a.exr", some_layers())


@pytest.mark.parametrize("share", [0.02, 0.5, 0.999])
def test_full_disk_is_one_line_and_no_file(tmp_path, share):
    """A limit on the size of files stands in for the full disk: the same failing writes."""
    layers = some_layers(64, 64)
    limit = int(lay.write_exr(tmp_path / "whole.exr", layers).stat().st_size * share)
    program = f"""
        import resource, signal
        import numpy as np
        from lumigate.core import layers as lay
        layers = lay.read_exr("whole.exr")
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
        try:
            lay.write_exr("a.exr", layers)
        except lay.SceneError as error:
            raise SystemExit(7 if "cannot write a.exr" in str(error) and "\\n" not in str(error) else 8)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], cwd=tmp_path)
    assert done.returncode == 7
    assert [p.name for p in tmp_path.iterdir()] == ["whole.exr"]


def test_an_exposure_is_of_light_alone():
    arrays = {
        name: np.ones((2, 3, 4 if name == "Combined" else 3)) for name in ("Combined", "Indirect", "Direct_Lamps", "Albedo", "Normal")
    }
    bright = lay.exposed(lay.Layers(arrays, view_layer="Shot"), 2.0)
    assert bright.view_layer == "Shot"
    assert {name: tuple(array[0, 0]) for name, array in bright.items()} == {
        "Combined": (2, 2, 2, 1),
        "Indirect": (2, 2, 2),
        "Direct_Lamps": (2, 2, 2),
        "Albedo": (1, 1, 1),
        "Normal": (1, 1, 1),
    }
    assert (arrays["Indirect"] == 1).all()


def test_preview_is_the_standard_view(tmp_path):
    linear = np.array([[[0.0, 0.18, 1.0], [0.5, 4.0, np.nan]]], np.float32)
    path = lay.write_preview(tmp_path / "p.png", linear)
    pixels = oiio.ImageInput.open(str(path)).read_image(oiio.UINT8)
    np.testing.assert_array_equal(pixels, [[[0, 118, 255], [188, 255, 0]]])
    brighter = oiio.ImageInput.open(str(lay.write_preview(path, linear, exposure=1.0))).read_image(oiio.UINT8)
    assert brighter[0, 0, 1] == 162  # sRGB of .36


def test_preview_of_one_channel_is_grey(tmp_path):
    path = lay.write_preview(tmp_path / "p.png", np.full((2, 3), 0.18))
    pixels = oiio.ImageInput.open(str(path)).read_image(oiio.UINT8)
    assert pixels.shape == (2, 3, 3) and (pixels == 118).all()


def test_auto_exposure_is_shared_and_undoes_a_scale():
    rng = np.random.default_rng(2)
    arrays = {"a": rng.random((9, 9, 3)), "b": rng.random((9, 9, 3)) * 4}
    stops = lay.auto_exposure(arrays)
    scaled = lay.auto_exposure({n: a * 8 for n, a in arrays.items()})
    assert stops - scaled == pytest.approx(3)
    bright = np.concatenate([a.max(axis=2).ravel() for a in arrays.values()]) * 2**stops
    assert np.mean(bright < 0.8) == pytest.approx(0.95, abs=0.01)
    assert lay.auto_exposure([np.zeros((2, 2, 3))]) == 0.0
