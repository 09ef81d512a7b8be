"""Emitters that diffuse rays do not see: they are there for glossy surfaces alone."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.lamps import build_emitters
from lumigate.core.lamps.tables import GLOSSY_ONLY, SEEN_BY_GLOSSY
from lumigate.core.particles import trace_particles
from lumigate.headless.stress.arrays import glossy_materials

from .test_lamps import EMISSIVE_QUAD, RECEIVER, Lit, lamp, scene_of


def hidden(shiny, visibility=sc.ALL_RAYS & ~sc.DIFFUSE):
    """A plane, glossy or not, under a lamp of that visibility and one for all rays."""
    scene = scene_of(lamp(sc.POINT, 10, (0.2, 0, 1)), lamp(sc.POINT, 1, (-0.2, 0, 1)))
    if shiny:
        scene.materials = glossy_materials((0.5, 0), albedo=0.3, roughness=0.3)
    scene.lamps.visibility[0] = visibility
    return scene


@pytest.mark.parametrize("shiny", [False, True])
def test_they_are_emitters_where_anything_is_glossy(shiny):
    emitters = build_emitters(hidden(shiny))
    assert emitters.source.tolist() == ([0, 1] if shiny else [1])
    assert ((emitters.flags & GLOSSY_ONLY) > 0).tolist() == ([True, False] if shiny else [False])
    assert (emitters.flags & SEEN_BY_GLOSSY).all()
    assert build_emitters(hidden(shiny, sc.CAMERA | sc.TRANSMISSION)).source.tolist() == [1]


def test_they_give_no_irradiance():
    points = [[0, 0, 0], [1, 0.5, 0]]
    alone = scene_of(lamp(sc.POINT, 1, (-0.2, 0, 1)))
    alone.materials = glossy_materials((0.5, 0), albedo=0.3, roughness=0.3)
    np.testing.assert_allclose(Lit(hidden(True))(points), Lit(alone)(points), rtol=1e-5)


def test_their_particles_leave_by_the_lobe():
    def left(visibility, albedo):
        scene = hidden(True, visibility)
        scene.materials = glossy_materials((albedo, 0), albedo=0.3, roughness=0.3)
        light = Lit(scene)  # whose rays go with it
        return trace_particles(light.tables, 2**15, 1, seed=1)[0].flux.sum(dtype=float)

    lobe, both = left(sc.ALL_RAYS, 0.0), left(sc.ALL_RAYS, 0.5)
    # The lamp that is hidden has ten elevenths of the light.
    assert left(sc.ALL_RAYS & ~sc.DIFFUSE, 0.5) == pytest.approx((10 * lobe + both) / 11, rel=0.02)


def test_shining_objects_and_the_world():
    scene = scene_of(world=0.5, quad=(RECEIVER, EMISSIVE_QUAD), material=[0, 1], surfaces=((0.5, 0), (0, 5)))
    scene.materials.tables.flags[0] |= sc.GLOSSY_LOBE
    g = scene.geometry
    g.object, g.object_names = np.repeat(np.arange(2, dtype=np.int32), 2), ["floor", "quad"]
    g.object_visibility = np.array([sc.ALL_RAYS, sc.ALL_RAYS & ~sc.DIFFUSE], np.uint32)
    scene.world.visibility = sc.GLOSSY
    emitters = build_emitters(scene)
    assert len(emitters.kind) == 3
    assert (emitters.flags & GLOSSY_ONLY).all()
