"""Portals: rays to the world go through the windows that they mark, and find as much light as without them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import stages
from lumigate.core.jit import kernel
from lumigate.core.lamps.openings import no_openings
from lumigate.core.lamps.world import faces_portals, sample_world, world_density, world_table
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.stress import arrays

F = np.float32
BOX = np.array([[-5.0, -5, -5], [5, 5, 5]])
# Centre and halves of the edges; both face down, by y cross x, and one overlaps the other to the eye.
WINDOW = [[0.6, 0.0, 1.0], [0.25, 0, 0], [0, 0.25, 0]]
HIGHER = [[0.8, 0.1, 1.5], [0.3, 0, 0], [0, 0.4, 0]]
PLACES = {
    "below": ((0, 0, 0), (0, 0, 1)),
    "tilted": ((0, 0, 0), (0.6, 0, 0.8)),
    "at a slant": ((-8, 3, 0.98), (0.9, -0.3, 0.3)),
    "close": ((0.5, 0.1, 0.999), (0, 0, 1)),
    "half above the horizon": ((0.6, 0.6, 0.9), (0, -1, 0)),
    "above": ((0.6, 0, 1.2), (0, 0, 1)),
}


def sky(varied, *portals):
    """A world's table and its image."""
    radiance = np.ones((1, 1, 3), F)
    if varied:
        radiance = np.random.default_rng(1).uniform(0.1, 1, (16, 32, 3)).astype(F)
        radiance[2, 5] = 30
    return world_table(radiance, BOX, 1.0, np.array(portals, F).reshape(-1, 3, 3))[0]


@kernel
def _found(table, x, y, z, nx, ny, nz, centre_x, centre_y, half, height, samples):
    """Means over the samples: irradiance from all of the sky, and from one rectangle across z; 1 / density of the directions above."""
    whole = window = above = 0.0
    for i in range(samples):
        u1, u2 = np.float32((i + 0.5) / samples), np.float32((i * 0.6180339887498949) % 1.0)
        dx, dy, dz, r, _, _ = sample_world(table, x, y, z, nx, ny, nz, u1, u2)
        cosine = dx * nx + dy * ny + dz * nz
        if cosine <= 0:
            continue
        above += 1 / world_density(table, x, y, z, nx, ny, nz, dx, dy, dz)
        whole += cosine * r
        t = (height - z) / dz if dz != 0 else -1.0
        if t > 0 and abs(x + t * dx - centre_x) < half and abs(y + t * dy - centre_y) < half:
            window += cosine * r
    return whole / samples, window / samples, above / samples


def by_quadrature(place, normal, n=1500):
    """Irradiance by a sky of radiance 1 through WINDOW."""
    side = (np.arange(n) + 0.5) / n - 0.5
    u, v = np.meshgrid(0.5 * side, 0.5 * side)
    to = np.stack([0.6 + u - place[0], v - place[1], np.full_like(u, 1.0 - place[2])], -1)
    r2 = (to * to).sum(-1)
    cosine = np.maximum(to @ np.asarray(normal, float), 0) / np.sqrt(r2)
    return float((cosine * to[..., 2] / np.sqrt(r2) / r2).mean() * 0.25)


@pytest.mark.parametrize("portals", [(WINDOW,), (WINDOW, HIGHER)], ids=["one", "two"])
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_light_is_the_same_by_portals(place, portals):
    p, n = np.array(place[0], F), np.array(place[1], float)
    n = (n / np.linalg.norm(n)).astype(F)
    samples = 400_000
    table = sky(False, *portals)
    whole, window, above = _found(table, *p, *n, 0.6, 0.0, 0.25, 1.0, samples)
    assert whole == pytest.approx(math.pi, rel=2e-3)
    assert above == pytest.approx(2 * math.pi, rel=4e-3)
    if p[2] < 1:
        assert window == pytest.approx(by_quadrature(p, n), rel=3e-3)
    # Of a sky that varies as much as without portals.
    wholes = [_found(sky(True, *these), *p, *n, 0.6, 0.0, 0.25, 1.0, samples)[0] for these in (portals, ())]
    assert wholes[0] == pytest.approx(wholes[1], rel=0.01)


def test_portals_that_face_away_or_lie_below_the_horizon_guide_nothing():
    table = sky(False, WINDOW)
    for p, n, faced in (
        ((0, 0, 0), (0, 0, 1), True),
        ((0, 0, 2), (0, 0, 1), False),
        ((0, 0, 0), (0, 0, -1), False),
        ((0, 0, 1), (1, 0, 0), False),
    ):
        assert faces_portals(table, *map(F, p), *map(F, n)) == faced


def room(window=0.3):
    """A room of 4 m with a window of so many metres in its ceiling, which lies 2 m above the camera in the origin, and the window's portal."""
    half, top = window / 2, 2.0
    walls = [(-2.0, -2), (2, -2), (2, 2), (-2, 2)]
    quads = [[(x, y, -1.0) for x, y in walls]]
    for (ax, ay), (bx, by) in zip(walls, walls[1:] + walls[:1]):
        quads.append([(ax, ay, -1), (bx, by, -1), (bx, by, top), (ax, ay, top)])
    for x0, x1, y0, y1 in ((-2, -half, -2, 2), (half, 2, -2, 2), (-half, half, -2, -half), (-half, half, half, 2)):
        quads.append([(x0, y0, top), (x1, y0, top), (x1, y1, top), (x0, y1, top)])
    g = arrays.geometry(*arrays.quads(*quads))
    made = arrays.scene(g, arrays.materials((0.5, 0)), world=(2, 2, 2), camera=arrays.camera((0, 0, 1.5), 24, 24))
    made.world.portals = np.array([[[0, 0, top - 0.001], [half, 0, 0], [0, half, 0]]], F)
    return made


@pytest.mark.parametrize("gather", [0, 16])
def test_a_small_window_lights_a_room_with_less_noise_and_the_same_light(monkeypatch, gather):
    monkeypatch.setattr(stages, "find_openings", lambda *_: no_openings())  # which do as much for a room without portals
    made, errors, means = room(), [], []
    settings = RenderSettings(method="importance-sampling", direct_samples=4, gather=gather, denoise=False)
    portals = made.world.portals
    truth = render(made, RenderSettings(method="importance-sampling", direct_samples=512, gather=0, denoise=False)).layers["Direct"]
    for made.world.portals in (portals, portals[:0]):
        light = [render(made, replace(settings, seed=seed)).layers["Direct"] for seed in range(3)]
        means.append(float(np.mean(light)))
        errors.append(float(np.mean([(one - truth) ** 2 for one in light])))
    assert means[0] == pytest.approx(float(truth.mean()), rel=0.01)
    assert errors[0] < 0.1 * errors[1]
