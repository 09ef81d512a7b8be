"""Rays to the world that are aimed by what neighbours have found of it."""

import math
from types import SimpleNamespace

import numpy as np

from lumigate.core.lamps import direct_irradiance, world_guide
from lumigate.core.sampling.sequences import sobol

from .test_lamps import RECEIVER, UP, lit

HALF = 0.25  # of the window's edge
HEIGHT = 1.0


def window(x=0.6):
    """A floor under a wide roof with a square window at (x, 0, HEIGHT)."""
    low, high, wide = -HALF, HALF, 40.0
    z = HEIGHT
    panels = [
        [(-wide, -wide, z), (x + low, -wide, z), (x + low, wide, z), (-wide, wide, z)],
        [(x + high, -wide, z), (wide, -wide, z), (wide, wide, z), (x + high, wide, z)],
        [(x + low, -wide, z), (x + high, -wide, z), (x + high, low, z), (x + low, low, z)],
        [(x + low, high, z), (x + high, high, z), (x + high, wide, z), (x + low, wide, z)],
    ]
    return lit(world=1.0, quad=(RECEIVER, *panels))


def points_around(n, radius=0.02, seed=0):
    """n points of the floor close to the origin."""
    position = np.zeros((n, 3), np.float32)
    position[:, :2] = np.random.default_rng(seed).uniform(-radius, radius, (n, 2))
    up = np.tile(np.float32(UP), (n, 1))
    return SimpleNamespace(position=position, ns=up, ng=up, error=np.full(n, 1e-6, np.float32))


def form_factor(x=0.6):
    """Share of the floor's irradiance at the origin that comes through the window."""
    u, v = np.meshgrid(*(np.linspace(-HALF, HALF, 401)[:-1] + HALF / 400,) * 2)
    r2 = (u + x) ** 2 + v**2 + HEIGHT**2
    return float((HEIGHT**2 / (math.pi * r2**2)).mean() * (2 * HALF) ** 2)


def unguided(light, points, samples, seed):
    """What the same rays find at points that have no neighbours to ask."""
    parts = []
    for k in range(len(points.position)):
        one = SimpleNamespace(**{name: value[k : k + 1] for name, value in vars(points).items()})
        parts.append(direct_irradiance(light.tables, one, samples, seed + k)[0])
    return np.concatenate(parts)


def test_the_sky_through_a_window_is_right_in_the_mean_and_less_noisy():
    light, points = window(), points_around(4096)
    expected = math.pi * form_factor()
    found, _ = direct_irradiance(light.tables, points, 8, 1)
    values = found[:, 0].astype(np.float64)
    error = values.std() / math.sqrt(len(values))
    assert abs(values.mean() - expected) < 4 * error
    assert error < 0.01 * expected
    alone = unguided(light, points_around(1024), 8, 5)[:, 0]
    assert values.std() < 0.5 * alone.std()


def test_two_samples_are_right_in_the_mean():
    """One of them is aimed: its share must not depend on what the other has found."""
    light = window()
    values = np.concatenate([direct_irradiance(light.tables, points_around(4096, seed=s), 2, s)[0][:, 0] for s in range(8)]).astype(
        np.float64
    )
    error = values.std() / math.sqrt(len(values))
    assert abs(values.mean() - math.pi * form_factor()) < 4 * error
    assert error < 0.01 * math.pi * form_factor()


def test_few_neighbours_are_right_in_the_mean():
    """Rows of a few points, whose own rays are a good part of what is known."""
    light = window()
    values = np.concatenate([direct_irradiance(light.tables, points_around(3, seed=s), 4, s)[0][:, 0] for s in range(6000)]).astype(
        np.float64
    )
    # Points of a row learn from each other, but none from itself: their values are uncorrelated enough for this bound.
    error = values.std() / math.sqrt(len(values))
    assert abs(values.mean() - math.pi * form_factor()) < 4 * error


def test_an_open_world_has_no_more_noise_than_before():
    light = lit(world=0.7)
    found, _ = direct_irradiance(light.tables, points_around(500), 8, 1)
    assert np.allclose(found, 0.7 * math.pi, rtol=1e-4)


def test_cells_cover_the_sphere_evenly():
    u = np.array([[sobol(i, d, 7) for d in range(2)] for i in range(64)], np.float32)
    directions = np.array([world_guide.in_cell(np.int64(c), a, b) for c in range(world_guide.CELLS) for a, b in u])
    assert np.allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-5)
    cells = np.array([world_guide.cell_of(*np.float32(d)) for d in directions])
    assert (cells == np.repeat(np.arange(world_guide.CELLS), len(u))).mean() > 0.99  # rounding at their edges
    assert np.allclose(directions.mean(axis=0), 0, atol=0.01)
    assert np.allclose((directions[:, :, None] * directions[:, None]).mean(axis=0), np.eye(3) / 3, atol=0.01)
