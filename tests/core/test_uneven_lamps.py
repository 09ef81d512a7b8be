"""Lamps that shine unevenly: direct light against a closed form, particles against direct light, and what rays see of them."""

import math

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.inspection import contents, foresee
from lumigate.core.jit import kernel
from lumigate.core.lamps import build_emitters
from lumigate.core.lamps.emission import focused
from lumigate.core.lamps.tables import MAP, PER_MEAN
from lumigate.core.lamps.textured import HEIGHT, WIDTH, direction_density, draw_direction, draw_place, place_density
from lumigate.core.sampling.sequences import sobol
from lumigate.core.surfaces.program import EMISSION_CLOSURE, END, LAMP_INCOMING, LAMP_PLACE, MATRIX, OWN_ROWS, REGISTERS

from .test_lamps import AREAS, DISTANT, SENDERS, Lit, cell_irradiance, emitted, lamp, scene_of

# What a program shows: 2 (rows . direction of the light + 4th), and the same of the place, both in the lamp's own axes.
BY_DIRECTION = np.array([[0.9, 0.4, 0.2, 0.1], [-0.5, 0.6, -0.3, 0.4], [0.1, -0.8, -0.9, 0.2]], np.float32)
BY_PLACE = np.array([[2.0, 0.3, 0.0, 0.2], [-1.5, 1.0, 0.4, 0.3], [0.3, -2.0, 0.0, 0.1]], np.float32)


def uneven(*rows, dark=False, **options):
    """`scene_of` lamps that all have a program, the material 1."""
    scene = scene_of(*rows, surfaces=((0.5, 0), (0, 0)), **options)
    constants = np.zeros((OWN_ROWS + 8, 4), np.float32)
    constants[OWN_ROWS] = 0 if dark else 2
    constants[OWN_ROWS + 1 : OWN_ROWS + 4], constants[OWN_ROWS + 4 : OWN_ROWS + 7] = BY_DIRECTION, BY_PLACE
    first = REGISTERS + OWN_ROWS
    code = [[END] + [0] * 7]
    for given, table in ((LAMP_INCOMING, first + 1), (LAMP_PLACE, first + 4)):
        code.append([MATRIX, 0, REGISTERS + given, table, REGISTERS, REGISTERS, REGISTERS, 0])
        code.append([EMISSION_CLOSURE, 1, 0, REGISTERS, REGISTERS, first, REGISTERS, 0])
    code.append([END] + [0] * 7)
    tables = scene.materials.tables
    scene.materials.tables = tables._replace(
        code=np.array(code, np.int32),
        constants=constants,
        start=np.array([0, 1], np.int32),
        flags=np.array([sc.CONSTANT, sc.EMISSIVE], np.int32),
    )
    scene.lamps.program = np.ones(len(rows), np.int32)
    scene.lamps.emission[:] = scene.lamps.emission.mean(
        1, keepdims=True
    )  # flux knows a lamp's own colour, and not how that goes with its program's
    if scene.lamps.soft_falloff.any():  # of which a particle leaves the disk across its way, and a ray sees the one that faces it
        constants[OWN_ROWS + 4 : OWN_ROWS + 7, :3] = 0
    return scene


def test_a_point_lamp_shines_as_its_program_says():
    row = lamp(sc.POINT, (10, 5, 2), (0.5, 0.2, 1.0))
    points = np.array([[0, 0, 0], [1, -0.4, 0], [-0.6, 0.9, 0]])
    found = Lit(uneven(row))(points)
    way = points - row["position"]
    r2 = (way**2).sum(1, keepdims=True)
    way /= np.sqrt(r2)
    shown = 2 * np.maximum(way @ row["axes"].T @ BY_DIRECTION[:, :3].T + BY_DIRECTION[:, 3], 0) + 2 * BY_PLACE[:, 3]
    np.testing.assert_allclose(found, shown * np.mean(row["emission"]) * -way[:, 2:] / r2, rtol=1e-4)


ROWS = {name: SENDERS[name][0] for name in SENDERS if SENDERS[name][0] and name != "all"}


@pytest.mark.parametrize("name", ROWS)
def test_particles_carry_the_light_that_direct_light_finds(name):
    light = Lit(uneven(*ROWS[name]))
    expected = cell_irradiance(light)
    found, power, _ = emitted(light.emitters, 2**20)
    assert power.mean() == pytest.approx(light.emitters.flux.sum(0).mean(), rel=0.02)
    assert abs(found.sum() / expected.sum() - 1) < 5e-3
    assert np.abs(found - expected).max() < 0.02 * expected.max()


@pytest.mark.parametrize("name", [name for name in DISTANT if DISTANT[name][0]])
def test_particles_of_lamps_far_off(name):
    light = Lit(uneven(*DISTANT[name][0]))
    near = focused(light.emitters, np.random.default_rng(3).uniform((-1, -1, 0), (1, 1, 1.5), (500, 3)))
    expected = cell_irradiance(light)[1:3, 1:3]
    np.testing.assert_allclose(emitted(near, 2**18)[0][1:3, 1:3].sum((0, 1)), expected.sum((0, 1)), rtol=0.02, atol=0.01 * expected.sum())


def test_a_narrow_beam_draws_its_particles():
    """A lamp that sends nearly all of its light through one cell: most particles take the same way."""
    light = Lit(uneven(lamp(sc.POINT, 1, (0, 0, 1))))
    emitters = light.emitters
    scene = uneven(lamp(sc.POINT, 1, (0, 0, 1)))
    scene.materials.tables.constants[OWN_ROWS + 1 : OWN_ROWS + 4] = [[0, 0, -40, -39]] * 3
    scene.materials.tables.constants[OWN_ROWS + 4 : OWN_ROWS + 7] = 0
    beam = Lit(scene)
    assert beam.emitters.flux.sum() < 0.1 * emitters.flux.sum()
    expected = cell_irradiance(beam, cells=1, half=0.3, side=200)
    few = [emitted(beam.emitters, 2**10, cells=1, half=0.3, seed=seed)[0].mean() for seed in range(16)]
    assert np.mean(few) == pytest.approx(expected.mean(), rel=0.02)
    assert np.std(few) < 0.1 * np.mean(few)


def test_a_lamp_that_its_program_leaves_dark():
    emitters = build_emitters(uneven(lamp(sc.POINT, 1), dark=True))
    assert len(emitters.kind) == 0


def test_an_even_program_changes_nothing():
    row = lamp(sc.SPOT, 10, (0.5, 0.2, 0.9), (-0.2, -0.1, -1), angle=1.6, blend=0.5, radius=0.4)
    scene = uneven(row)
    scene.materials.tables.constants[OWN_ROWS + 1 : OWN_ROWS + 7, :3] = 0
    scene.materials.tables.constants[OWN_ROWS + 1 : OWN_ROWS + 7, 3] = 0.75
    points = [[0, 0, 0], [0.5, 0.3, 0], [-0.4, 0.7, 0]]
    np.testing.assert_allclose(Lit(scene)(points), 3 * Lit(scene_of(row))(points), rtol=1e-5)
    emitters = build_emitters(scene)
    assert emitters.lamps[0, PER_MEAN] == pytest.approx(1 / 3)
    np.testing.assert_allclose(emitters.flux, 3 * build_emitters(scene_of(row)).flux, rtol=1e-6)


def test_programs_of_lamps_are_no_materials():
    scene = uneven(lamp(sc.POINT, 1))
    emitters = build_emitters(scene)
    assert contents(scene, emitters)["materials"] == {"count": 1, "textured": 0, "emissive": 0, "transparent": 0}
    skipped, warnings = foresee(scene, emitters)
    assert not skipped
    assert not warnings


@kernel
def _drawn(emitters, count, directions, out):
    """Directions, or places, of lamp 0 by its map, and their densities; out: (count, 4)."""
    for i in range(count):
        u1, u2 = sobol(i, 0, np.uint32(1)), sobol(i, 1, np.uint32(1))
        if directions:
            out[i, 0], out[i, 1], out[i, 2] = draw_direction(emitters.maps, emitters.lamps, 0, u1, u2)
            out[i, 3] = direction_density(emitters.maps, emitters.lamps, 0, out[i, 0], out[i, 1], out[i, 2])
        else:
            out[i, 0], out[i, 1] = draw_place(emitters.maps, emitters.lamps, 0, u1, u2)
            out[i, 3] = place_density(emitters.maps, emitters.lamps, 0, out[i, 0], out[i, 1])


@pytest.mark.parametrize("row", [lamp(sc.POINT, 1, radius=0.2), AREAS["ellipse"]], ids=["point", "area"])
def test_densities_of_maps(row):
    emitters = build_emitters(uneven(row))
    assert emitters.lamps[0, MAP] == 0
    directions = row["kind"] == sc.POINT
    out = np.zeros((2**16, 4), np.float32)
    _drawn(emitters, len(out), directions, out)
    whole = 4 * math.pi if directions else 1.0
    # Of a density, the mean of its inverse is the measure of where it is not zero.
    lit = (np.diff(emitters.maps.columns[0], axis=1) > 0).mean()
    assert lit == (1 if directions else pytest.approx(math.pi / 4, abs=0.06))
    assert (1 / out[:, 3].astype(float)).mean() == pytest.approx(whole * lit, rel=0.02)
    assert emitters.maps.columns.shape == (1, HEIGHT, WIDTH + 1)
