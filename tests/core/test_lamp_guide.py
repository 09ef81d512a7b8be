"""Rays to large lamps that are aimed by what neighbours have seen of them."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.lamps import direct_irradiance
from lumigate.core.lamps.lamp_guide import CELLS, MOST, cell_on_lamp, new_lamp_guide

from .test_lamps import RECEIVER, lamp, lit
from .test_world_guide import assert_right_in_the_mean, points_around, roof, unguided

TOWARDS = (-0.3, -0.2, -1)  # not along the middle of what is seen: samples in strata of a cone about that would need no guide
BEHIND_THE_WINDOW = {
    "area": lamp(sc.AREA, 1, (3.6, 0, 6), size=(20, 20)),
    "disk": lamp(sc.AREA, 1, (3.6, 0, 6), size=(24, 24), shape=1),
    "sphere": lamp(sc.POINT, 1, (10, 8, 36), radius=30.0),
    "sun": lamp(sc.SUN, 1, (0, 0, 9), TOWARDS, angle=math.radians(100)),
}


def behind_a_window(name):
    """A floor under a roof with a window, behind which one large lamp is all there is to see, of radiance 1."""
    if name == "mesh":
        corners = [(-9, 11, 6), (16, 11, 6), (16, -11, 6), (-9, -11, 6)]
        return lit(quad=(RECEIVER, *roof(), corners), material=[0] * 5 + [1], surfaces=((0.5, 0.0), (0.0, 1.0)))
    light = lit(BEHIND_THE_WINDOW[name], quad=(RECEIVER, *roof()))
    light.emitters.radiance[:] /= light.emitters.radiance[0, 0]
    return light


@pytest.mark.parametrize("name", [*BEHIND_THE_WINDOW, "mesh"])
def test_a_large_lamp_through_a_window_is_right_in_the_mean_and_less_noisy(name):
    light = behind_a_window(name)
    found, _ = direct_irradiance(light.tables, points_around(4096), 8, 1)
    assert_right_in_the_mean(found, 0.018)
    alone = unguided(light, points_around(1024), 8, 5)
    assert found[:, 0].std() < 0.75 * alone[:, 0].std()


def test_two_samples_and_few_neighbours_are_right_in_the_mean():
    """One of two is aimed: its share must not depend on what the other has found, nor may the aim of three points on their own."""
    light = behind_a_window("area")
    many = np.concatenate([direct_irradiance(light.tables, points_around(4096, seed=s), 2, s)[0] for s in range(8)])
    assert_right_in_the_mean(many, 0.015)
    few = np.concatenate([direct_irradiance(light.tables, points_around(3, seed=s), 4, s)[0] for s in range(6000)])
    assert_right_in_the_mean(few, 0.03)


def test_passes_go_on_in_their_sequences():
    """Passes of 8 samples converge as quickly as their number, and no two are alike."""
    light, points = behind_a_window("area"), points_around(512)
    passes = np.array([direct_irradiance(light.tables, points, 8, 1, first=k)[0][:, 0] for k in range(16)], np.float64)
    assert passes.mean(axis=0).std() < 0.35 * passes.std(axis=1).mean()
    assert (np.abs(np.diff(passes, axis=0)).max(axis=1) > 0).all()


def test_a_lamp_in_the_open_is_sampled_as_if_there_were_no_guide():
    light, points = lit(lamp(sc.AREA, 1, (0, 0, 3), size=(2, 2))), points_around(256)
    found, _ = direct_irradiance(light.tables, points, 8, 1)
    one = SimpleNamespace(**{name: value[:1] for name, value in vars(points).items()})
    np.testing.assert_array_equal(found[:1], direct_irradiance(light.tables, one, 8, 1)[0])
    assert found[:, 0].std() < 0.01 * found[:, 0].mean()


def test_small_lamps_need_no_guide_and_many_have_none():
    lamps = [lamp(sc.POINT, 1, (k, 0, 3), radius=0.001) for k in range(3)] + [lamp(sc.AREA, 1, (k, 0, 3)) for k in range(3)]
    guide = new_lamp_guide(lit(*lamps).emitters, 64, 8)
    assert sorted(guide.slot) == [-1, -1, -1, 0, 1, 2]
    suns = [lamp(sc.SUN, 1, angle=1.0) for _ in range(MOST + 3)]
    assert (new_lamp_guide(lit(*suns).emitters, 64, 8).slot >= 0).sum() == MOST


def test_cells_cover_the_square_evenly():
    u = (np.arange(64, dtype=np.float32) + 0.5) / 64
    cells = [cell_on_lamp(a, b) for a in u for b in u]
    np.testing.assert_array_equal(np.bincount(cells, minlength=CELLS), 64 * 64 // CELLS)
    assert cell_on_lamp(np.float32(1), np.float32(1)) == CELLS - 1


def test_light_whose_sum_is_no_number_is_not_aimed():
    light, points = behind_a_window("area"), points_around(4096)
    expected, _ = direct_irradiance(light.tables, points, 8, 1)
    light.emitters.radiance[:] *= np.float32(1e36)
    found, _ = direct_irradiance(light.tables, points, 8, 1)
    assert np.isfinite(found).all()
    assert found[:, 0].mean(dtype=float) == pytest.approx(1e36 * float(expected[:, 0].mean()), rel=0.1)
