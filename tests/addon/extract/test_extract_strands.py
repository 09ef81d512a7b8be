"""Hair curves, hair particles and point clouds as triangles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract.strands import Strands, hashed, tubes
from lumigate.addon.materials.requests import INTERCEPT, RANDOM, THICKNESS

from .test_extract_geometry import area, geometric_normals


def curves(stage, points, radius=None, material="Hair"):
    """A Curves object of (S, K, 3) points."""
    points = np.asarray(points, np.float32)
    data = bpy.data.hair_curves.new("Hairdo")
    data.add_curves([points.shape[1]] * len(points))
    data.attributes["position"].data.foreach_set("vector", points.ravel())
    if radius is not None:
        data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", np.full(points.shape[:2], radius, np.float32).ravel())
    data.materials.append(stage.material(material))
    return stage.link("Hairdo", data)


def fur(stage, name="Furry", **settings):
    """A cube with four hairs, straight out, of the material in its second slot."""
    furry = stage.cube(name, "Skin", "Hair")
    furry.modifiers.new("Fur", "PARTICLE_SYSTEM")
    of_hair = furry.particle_systems[0].settings
    of_hair.type = "HAIR"
    for key, value in {
        "count": 4,
        "hair_length": 2.0,
        "root_radius": 1.0,
        "tip_radius": 1.0,
        "radius_scale": 0.02,
        "material": 2,
        **settings,
    }.items():
        setattr(of_hair, key, value)
    return furry


def straight(count, length=1.0, points=4):
    return [[(0.1 * i, 0, length * k / (points - 1)) for k in range(points)] for i in range(count)]


@pytest.mark.parametrize("count", [3, 6000])
def test_a_hair_is_as_wide_as_a_cylinder(stage, count):
    """Its mean width over all views, which is the tube's perimeter over pi, whatever the number of sides."""
    curves(stage, straight(count), radius=0.004)
    scene = stage.extract()
    assert area(scene) == pytest.approx(count * 2 * math.pi * 0.004, rel=1e-3)
    assert not scene.warnings
    g = scene.geometry
    faces = geometric_normals(scene)
    assert np.einsum("tc,tkc->tk", faces, g.corner_normals).min() > 0.4, "normals lead outwards, as the faces do"
    assert np.abs(g.corner_normals[..., 2]).max() < 1e-5


def test_sharp_turns_leave_no_invalid_tube():
    points = np.array([(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0), (1, 0, 0), (1, 1, 0)], np.float32)
    copy = tubes(Strands(points, np.full(6, 0.01, np.float32), np.array([0, 6])), "Bent")
    assert np.isfinite(copy.vertices).all()
    np.testing.assert_allclose(np.linalg.norm(copy.normals, axis=-1), 1, atol=1e-5)
    spread = np.linalg.norm(copy.vertices.reshape(-1, 8, 3) - copy.vertices.reshape(-1, 8, 3).mean(1, keepdims=True), axis=2)
    np.testing.assert_allclose(spread, spread[0, 0], rtol=1e-4)


def test_what_hair_info_reads():
    points = np.array(straight(2, 2.0, 3), np.float32).reshape(-1, 3)
    copy = tubes(Strands(points, np.tile(np.float32([0.02, 0.01, 0]), 2), np.array([0, 3, 6])), "Two")
    heights = copy.vertices[copy.corners][..., 2]
    np.testing.assert_allclose(copy.layers[INTERCEPT][..., 0], heights / 2, atol=1e-5)
    np.testing.assert_allclose(copy.layers[THICKNESS][heights == 1][:, 0], 0.02, rtol=1e-5)
    assert len(np.unique(copy.layers[RANDOM][..., 0])) == 2
    corners = copy.vertices[copy.corners]
    assert np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).min() > 0, (
        "closed tips have no flat triangles"
    )


def test_hashes_are_cycles_own():
    # As `hash_uint2` gives them for (kx, 0), written out by hand for one value.
    def one(value):
        mask, rotated = 0xFFFFFFFF, lambda x, k: ((x << k) | (x >> (32 - k))) & 0xFFFFFFFF
        a = b = c = (0xDEADBEEF + (2 << 2) + 13) & mask
        a = (a + value) & mask
        c = ((c ^ b) - rotated(b, 14)) & mask
        a = ((a ^ c) - rotated(c, 11)) & mask
        b = ((b ^ a) - rotated(a, 25)) & mask
        c = ((c ^ b) - rotated(b, 16)) & mask
        a = ((a ^ c) - rotated(c, 4)) & mask
        b = ((b ^ a) - rotated(a, 14)) & mask
        return ((c ^ b) - rotated(b, 24)) & mask

    assert hashed(np.array([0, 1, 77])).tolist() == [one(0), one(1), one(77)]


@pytest.mark.parametrize("is_emitter_shown", [True, False])
def test_hair_particles_wear_their_own_slot(stage, is_emitter_shown):
    furry = fur(stage)
    furry.show_instancer_for_render = is_emitter_shown
    stage.cube("Other").location.x = 9
    scene = stage.extract()
    g = scene.geometry
    hair = np.flatnonzero([name == "Furry" for name in g.object_names])
    assert len(hair) == 1 + is_emitter_shown
    tube = g.object == hair[-1]
    assert tube.sum() > 12
    reach = np.linalg.norm(g.vertices[g.triangles[tube]] + scene.origin, axis=-1, ord=np.inf).max()
    assert reach == pytest.approx(3, abs=0.05), "hairs of 2 m on a cube from -1 to 1"


def test_hair_that_a_render_hides_is_not_seen(stage):
    furry = fur(stage)
    furry.modifiers[0].show_render = False
    assert len(stage.extract().geometry.triangles) == 12


def test_hair_of_a_lightmapped_mesh_is_not_baked(stage):
    furry = fur(stage)
    furry.data.uv_layers.new(name="Light")
    found = stage.extract(lightmaps={"Furry": "Light"}).geometry
    tube = found.object == 1
    assert np.isfinite(found.lightmap_uv[~tube]).all() and np.isnan(found.lightmap_uv[tube]).all()


@pytest.mark.parametrize("count", [2, 4000])
def test_points_are_balls_of_their_size(stage, count):
    ob = stage.mesh("Points", [(0.1 * i, 0, 0) for i in range(count)], [])
    group = bpy.data.node_groups.new("To points", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    begin, to_points, end = (group.nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeMeshToPoints", "NodeGroupOutput"))
    to_points.inputs["Radius"].default_value = 0.03
    group.links.new(begin.outputs[0], to_points.inputs[0])
    group.links.new(to_points.outputs[0], end.inputs[0])
    ob.modifiers.new("Points", "NODES").node_group = group
    scene = stage.extract()
    assert area(scene) == pytest.approx(count * 4 * math.pi * 0.03**2, rel=1e-3)
    assert not scene.warnings
    g = scene.geometry
    np.testing.assert_allclose(np.linalg.norm(g.corner_normals, axis=-1), 1, atol=1e-5)
    assert np.einsum("tc,tkc->tk", geometric_normals(scene), g.corner_normals).min() > 0.5
