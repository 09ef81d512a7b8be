"""Pictures that do not fit into memory come tile by tile; those that do are not cut."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import memory
from lumigate.core.errors import SceneError
from lumigate.core.pipeline import render
from lumigate.core.topology import IN_MEMORY
from lumigate.headless import tiled
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
    cut = tiled.render_fitting(
        scene, SETTINGS, lambda stage, done: heard.append(stage) or True, extraction_seconds=0.5, topologies=IN_MEMORY
    )
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
