"""Numbers that are none are set right or left out, with a line that names what they were in."""

import numpy as np
import pytest

from lumigate.core.soundness import sound
from lumigate.headless.stress import numbers, rooms

NAMED = {
    "an albedo": "material 'material 3'",
    "a shining material": "material 'material 3'",
    "a roughness": "material 'material 3'",
    "a pixel of a texture": "1 values of image textures",
    "a lamp's place": "lamp 'lamp'",
    "a lamp's axes": "lamp 'lamp'",
    "a lamp's size": "lamp 'lamp'",
    "a lamp's radius": "lamp 'lamp'",
    "a spot's cone": "lamp 'lamp'",
    "a pixel of the sky": "1 pixels of the world",
}


@pytest.mark.parametrize("bad", numbers.BAD.values(), ids=numbers.BAD)
@pytest.mark.parametrize("place", NAMED)
def test_what_is_no_number_is_named(place, bad):
    scene = rooms.room()
    numbers.PLACES[place](scene, bad)
    (line,) = sound(scene).warnings
    assert NAMED[place] in line and "no number" in line


def test_a_sound_scene_stays_itself():
    scene = rooms.room()
    made = sound(scene)
    assert made.geometry is scene.geometry and made.materials is scene.materials
    assert made.lamps is scene.lamps and made.world is scene.world and made.warnings == []


def test_the_given_arrays_are_not_touched():
    scene = rooms.room()
    scene.materials.tables.constant[2, 0] = np.nan
    sound(scene)
    assert np.isnan(scene.materials.tables.constant[2, 0])


def test_texels_that_are_no_number_are_counted():
    scene = rooms.room()
    texels = np.ones(10, np.float32)
    texels[[2, 5]] = np.nan, np.inf
    scene.materials.tables = scene.materials.tables._replace(texels_f32=texels)
    made = sound(scene)
    assert "2 values of image textures" in made.warnings[0]
    assert np.array_equal(made.materials.tables.texels_f32, np.where(np.isfinite(texels), texels, 0))


def test_a_number_too_large_to_compute_with_is_cut():
    scene = rooms.room()
    scene.world.radiance[:] = 1e30
    assert sound(scene).world.radiance.max() == pytest.approx(1e20)
