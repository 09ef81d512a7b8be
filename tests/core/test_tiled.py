"""Pictures that do not fit into memory come tile by tile; those that do are not cut."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import memory, tiled
from lumigate.core.errors import SceneError
from lumigate.core.layers import Layers
from lumigate.core.pipeline import render
from lumigate.core.tiles import HALO, Mosaic, tiles, with_halo
from lumigate.headless.stress import rooms

SETTINGS = replace(rooms.SETTINGS, method="instant-radiosity", vpls=512, direct_samples=4)


@pytest.fixture
def scene():
    return rooms.room(size=(320, 32))


def leave(monkeypatch, scene, pixels):
    """As much memory as a picture of `scene` of so many pixels a row takes."""
    seen = replace(scene, camera=replace(scene.camera, border=(0, 0, pixels, 32)))
    free = int(memory.estimate(seen, SETTINGS) / memory.SHARE) + 1
    for module in (memory, tiled):
        monkeypatch.setattr(module, "available", lambda: free)


def test_what_fits_is_not_cut(monkeypatch, scene):
    leave(monkeypatch, scene, 320)
    assert tiled.fitting_tiles(scene, SETTINGS) == []


def test_tiles_show_the_same_picture(monkeypatch, scene):
    whole = render(scene, SETTINGS)
    leave(monkeypatch, scene, 290)
    heard = []
    cut = tiled.render_fitting(scene, SETTINGS, lambda stage, done: heard.append(stage) or True, extraction_seconds=0.5)
    assert cut.stats["tiles"] == 3 and cut.stats["size"] == [320, 32]
    assert any(stage.startswith("tile 3 of 3: ") for stage in heard)
    assert sum("3 tiles" in line for line in cut.stats["warnings"]) == 1
    assert cut.stats["seconds"]["extraction"] == 0.5
    assert set(cut.layers) == set(whole.layers)
    for name in ("Depth", "Albedo", "Normal"):
        assert cut.layers[name].shape == whole.layers[name].shape
        assert np.abs(cut.layers[name] - whole.layers[name]).mean() < 0.01 * np.abs(whole.layers[name]).mean()
    for name in ("Direct", "Indirect"):
        assert cut.layers[name].mean() == pytest.approx(whole.layers[name].mean(), rel=0.05)


def test_what_no_tile_fits_is_refused(monkeypatch, scene):
    leave(monkeypatch, scene, 1)
    with pytest.raises(SceneError, match="GiB are free"):
        tiled.fitting_tiles(scene, SETTINGS)


@pytest.mark.parametrize("border", [(0, 0, 100, 70), (13, 7, 290, 48)])
@pytest.mark.parametrize("side", [20, 64])
def test_tiles_cover_the_border_once(border, side):
    width, height = border[2], border[3]
    number = np.arange(width * height, dtype=np.float32).reshape(height, width, 1)
    cut = list(tiles(border, side))
    mosaic = Mosaic(cut, border)
    for tile in cut:
        x0, y0, x1, y1 = with_halo(tile, border)
        shown = {name: number[y0:y1, x0:x1] for name in ("Depth", "Indirect", "Direct_lamps")}
        mosaic.add(tile, Layers(shown, offset=(x0, y0), full_size=(width, height)))
    picture = mosaic.picture()
    assert picture.offset == border[:2] and picture.full_size == (width, height)
    inside = number[border[1] :, border[0] :]
    np.testing.assert_array_equal(picture["Depth"], inside)
    for name in ("Indirect", "Direct_lamps"):
        np.testing.assert_allclose(picture[name], inside, rtol=1e-6)


def test_tiles_that_differ_show_no_edge():
    border = (0, 0, 160, 4)
    cut = list(tiles(border, 80))
    mosaic = Mosaic(cut, border)
    for value, tile in enumerate(cut):
        x0, y0, x1, y1 = with_halo(tile, border)
        mosaic.add(tile, Layers({"Indirect": np.full((y1 - y0, x1 - x0, 3), value, np.float32)}, offset=(x0, y0), full_size=(160, 4)))
    row = mosaic.picture()["Indirect"][0, :, 0]
    assert np.abs(np.diff(row)).max() == pytest.approx(0.5 / HALO)
    assert row[80 - HALO] < 0.5 / HALO and row[79 + HALO] > 1 - 0.5 / HALO and row[:40].max() == 0 and row[120:].min() == 1


def test_a_part_of_a_picture_is_cut_where_it_does_not_fit(monkeypatch, scene):
    part = replace(scene, camera=replace(scene.camera, border=(20, 2, 310, 32)))
    leave(monkeypatch, scene, 270)
    cut = tiled.render_fitting(part, SETTINGS)
    assert cut.stats["tiles"] > 1 and cut.stats["size"] == [290, 30]
    assert cut.layers.offset == (20, 2) and cut.layers["Depth"].shape == (30, 290, 1)
    assert all(cut.layers["Depth"].all(axis=(1, 2)))
