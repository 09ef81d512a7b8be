"""Suns taken out of panoramas: their light, place and width, and what is no sun."""

import math

import numpy as np
import pytest

from lumigate.core.lamps.bright_spots import BRIGHT, MOST, take_out_suns
from lumigate.core.lamps.sharp import WIDEST_SUN
from lumigate.core.lamps.world import pixel_directions

HEIGHT, WIDTH = 512, 1024


def unit(*vector):
    return np.array(vector, float) / np.linalg.norm(vector)


def sky(height=HEIGHT, width=WIDTH):
    """A gradient of three colours."""
    direction, _ = pixel_directions(height, width)
    return (0.5 + 0.4 * direction[..., 2:] * np.array([0.2, 0.5, 1.0]) + np.zeros(3)).astype(np.float32)


def with_disc(panorama, towards, diameter, share, colour=(1.0, 0.9, 0.7)):
    """A disc of a diameter (rad) added, with so much of the light of what was there."""
    direction, angles = pixel_directions(*panorama.shape[:2])
    inside = direction @ towards >= math.cos(diameter / 2)
    solid = inside * angles
    total = (panorama.mean(-1) * angles).sum()
    return (panorama + (inside * share * total / solid.sum())[..., None] * np.array(colour) / np.mean(colour)).astype(np.float32)


def irradiance(panorama, normal):
    """(3,) on a plane."""
    direction, angles = pixel_directions(*panorama.shape[:2])
    return np.einsum("hw,hwc->c", np.maximum(direction @ normal, 0) * angles, panorama.astype(float))


PLACES = {"high": unit(0.3, 0.4, 0.8), "seam": unit(-1, 1e-4, 0.4), "zenith": unit(2e-3, 1e-3, 1), "below": unit(0.5, -0.7, -0.2)}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("share", [0.03, 1, 20])
def test_the_light_stays(place, share):
    towards = PLACES[place]
    panorama = with_disc(sky(), towards, math.radians(1), share)
    before = panorama.copy()
    rest, (sun,) = take_out_suns(panorama)
    assert np.array_equal(panorama, before)
    assert math.acos(min(sun.direction @ towards, 1)) < math.radians(0.18)  # half a pixel
    for normal in (towards, unit(0, 0, 1), unit(1, 0, 0.5), unit(0.5, -1, 0.5)):
        parted = irradiance(rest, normal) + sun.irradiance * max(0, sun.direction @ normal)
        np.testing.assert_allclose(parted, irradiance(panorama, normal), rtol=2e-3, atol=1e-4)
    assert rest.max() < 2 * sky().max()


def test_the_sky_behind_stays():
    panorama = with_disc(sky(), PLACES["high"], math.radians(1), 3)
    rest, _ = take_out_suns(panorama)
    np.testing.assert_allclose(rest, sky(), rtol=0.02)


@pytest.mark.parametrize("diameter", [0.53, 1.0, 1.6])
def test_width(diameter):
    _, (sun,) = take_out_suns(with_disc(sky(1024, 2048), PLACES["high"], math.radians(diameter), 1))
    pixel = 180 / 1024
    widened = math.sqrt(diameter**2 + 8 * pixel**2 / 6 * (1 + 1 - PLACES["high"][2] ** 2))  # as Cycles draws between pixels
    assert math.degrees(sun.angle) == pytest.approx(widened, rel=0.06)


def test_a_single_pixel():
    panorama = sky()
    panorama[100, 3] = 1e5
    rest, (sun,) = take_out_suns(panorama)
    assert rest[100, 3].max() < 1
    assert math.degrees(sun.angle) < 1


def test_several_suns_strongest_first():
    panorama = sky()
    for towards, share in zip((unit(1, 0, 0.3), unit(0, 1, 0.6), unit(-1, 0, 0.2)), (0.2, 0.6, 0.1)):
        panorama = with_disc(panorama, towards, math.radians(0.8), share)
    rest, suns = take_out_suns(panorama)
    strength = [sun.irradiance.mean() for sun in suns]
    assert len(suns) == 3 and strength == sorted(strength, reverse=True)
    np.testing.assert_allclose(rest, sky(), rtol=0.02)


def test_no_more_than_so_many():
    panorama = sky()
    for k in range(MOST + 2):
        panorama = with_disc(panorama, unit(math.cos(k), math.sin(k), 0.5), math.radians(0.8), 0.3)
    rest, suns = take_out_suns(panorama)
    assert len(suns) == MOST
    parted = irradiance(rest, unit(0, 0, 1)) + sum(sun.irradiance * sun.direction[2] for sun in suns)
    np.testing.assert_allclose(parted, irradiance(panorama, unit(0, 0, 1)), rtol=2e-3)


def dim_stars():
    panorama = sky()
    panorama[np.random.default_rng(0).integers(0, HEIGHT, 400), np.random.default_rng(1).integers(0, WIDTH, 400)] = 300
    return panorama


def with_pixel(value):
    panorama = sky()
    panorama[100, 100] = value
    return panorama


NO_SUNS = {
    "infinite": with_pixel(np.inf),
    "not a number": with_pixel(np.nan),
    "even": np.ones((1, 1, 3), np.float32),
    "black": np.zeros((HEIGHT, WIDTH, 3), np.float32),
    "gradient": sky(),
    "soft box": with_disc(np.full((HEIGHT, WIDTH, 3), 1e-3, np.float32), unit(1, 0, 0.3), math.radians(8), 1e4),
    "wide sun": with_disc(sky(), unit(1, 0, 0.3), math.radians(4), 50),
    "stars": dim_stars(),
    "coarse": with_disc(sky(64, 128), unit(1, 0, 0.3), math.radians(4), 50),
}


@pytest.mark.parametrize("name", NO_SUNS)
def test_no_suns(name):
    rest, suns = take_out_suns(NO_SUNS[name])
    assert not suns
    assert rest is NO_SUNS[name]


def test_the_soft_box_is_bright():
    """Or the case above would show nothing."""
    panorama = NO_SUNS["soft box"]
    assert panorama.max() > BRIGHT * irradiance(panorama, unit(1, 0, 0.3)).mean() / (4 * math.pi)
    assert math.radians(8) > WIDEST_SUN
