"""What a picture's light is foreseen to be: what shadow rays of a tile have found dims the lights that they were sent to."""

import numpy as np

from lumigate.core.methods.foreseen import BLOCK, EVEN, HIDDEN, TILE, VISIBLE, foreseen
from lumigate.core.view.points import ShadingPoints


def floor(width, height):
    """One point a pixel on the plane z = 0, next to nothing apart, and two blocks of lights 1 m above it that look down."""
    points = ShadingPoints.allocate(width * height)
    points.pixel[:] = np.arange(width * height)
    points.position[:] = np.stack([points.pixel % width, points.pixel // width, 0 * points.pixel], 1) * 1e-5
    points.ns[:] = points.ng[:] = 0, 0, 1
    lights = np.zeros((1, 9, 2 * BLOCK), np.float32)
    lights[0, 2], lights[0, 5], lights[0, 6], lights[0, 8] = 1, -1, 1, 1
    return points, lights


def of(points, lights, shape, sights, blocks, gathered=0.0):
    """Without what is the same everywhere."""
    found = foreseen(points, shape, lights, np.float32(1e30), sights, blocks, np.full(len(points.pixel), gathered, np.float32), 2)
    return found - EVEN / (1 + EVEN) * found.mean()


def test_hidden_lights_are_dark_in_their_tile_alone():
    shape = TILE, 4 * TILE
    points, lights = floor(shape[1], shape[0])
    left = points.pixel % shape[1] < 2 * TILE
    sights = np.full((len(left), 4), VISIBLE, np.uint8)
    blocks = np.tile(np.uint8([0, 0, 1, 1]), (len(left), 1))
    everything = of(points, lights, shape, sights, blocks)
    np.testing.assert_allclose(everything, 2 * BLOCK, rtol=0.01)
    sights[left, :2] = HIDDEN  # the first block, for the left half
    got = of(points, lights, shape, sights, blocks)
    column = points.pixel % shape[1]
    np.testing.assert_allclose(got[column < TILE], BLOCK, rtol=0.02)
    np.testing.assert_allclose(got[column >= 3 * TILE], 2 * BLOCK, rtol=0.02)
    between = got[: shape[1]]
    assert (np.diff(between) > -1e-4 * BLOCK).all()  # no step between tiles
    assert np.diff(between).max() < 0.1 * BLOCK


def test_rays_not_traced_tell_nothing():
    shape = 3, 5
    points, lights = floor(5, 3)
    sights, blocks = np.zeros((15, 2), np.uint8), np.full((15, 2), 255, np.uint8)
    sights[3], blocks[3] = VISIBLE, 0
    np.testing.assert_allclose(of(points, lights, shape, sights, blocks), 2 * BLOCK, rtol=0.01)


def test_gather_rays_light_what_lights_do_not():
    points, _ = floor(20, 20)
    none = np.zeros((1, 9, 0), np.float32)
    found = of(points, none, (20, 20), np.zeros((400, 0), np.uint8), np.zeros((400, 0), np.uint8), gathered=3.0)
    np.testing.assert_allclose(found, 3.0, rtol=1e-5)
    empty = points.take(slice(0, 0))
    assert foreseen(
        empty, (20, 20), none, np.float32(1), np.zeros((0, 0), np.uint8), np.zeros((0, 0), np.uint8), np.zeros(0, np.float32)
    ).shape == (0,)
