"""Whole renders of a dozen pixels, small enough for kernels that run as plain Python (`tests/plain.py`), against the float64 path tracer."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.stress import rooms
from lumigate.headless.stress.path_tracer import path_traced

SIZE = (4, 3)
PATHS = 500  # of the oracle: its standard error is a twentieth of the indirect light
SETTINGS = RenderSettings(
    vpls=16, bounces=2, pixel_samples=1, direct_samples=2, samples=4, gather=2, reflections=1, vals=1, voxels=16, vpl_clusters=4,
    point_clusters=4, fuzziness=2, interleave=2, denoise=False, threads=1, seed=3,
)  # fmt: skip
WAYS = {
    "shadow rays": {"method": "instant-radiosity"},
    "shadow maps": {"method": "instant-radiosity", "visibility": "shadow-maps"},
    "fuzzy clusters": {"method": "fuzzy-clustering"},
    "area lights": {"method": "virtual-area-lights"},
    "disks": {"method": "visibility-gates"},
    "polygons": {"method": "visibility-gates", "gates": "polygons"},
    "guided rays": {"method": "visibility-gates", "gates": "guided"},
    "sampled": {"method": "importance-sampling"},
}


def radiance(scene, **changes) -> np.ndarray:
    """Mean Direct and Indirect radiance of a picture, (2,)."""
    layers = render(scene, replace(SETTINGS, **changes)).layers
    assert all(np.isfinite(layer).all() for layer in layers.values())
    return np.array([layers[name].mean(dtype=float) for name in ("Direct", "Indirect")])


@pytest.fixture(scope="module")
def room():
    """The room of the stress cases, lit by its lamp."""
    return rooms.room(size=SIZE)


@pytest.fixture(scope="module")
def truth(room):
    """Its light and the standard error of that, (2,) each, by the path tracer."""
    mean, variance = path_traced(room, SETTINGS.bounces, PATHS, 1)
    return mean, variance**0.5


@pytest.mark.parametrize("way", WAYS)
def test_the_light_is_the_path_tracers(room, truth, way):
    mean, error = truth
    found = radiance(room, **WAYS[way])
    assert np.all(np.abs(found - mean) < 4 * error + (0.15, 0.25) * mean), (found, mean, error)
