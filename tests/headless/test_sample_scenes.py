"""The sample scenes: closed, deterministic, complete, and as detailed as they say."""

from __future__ import annotations

import hashlib

import bpy  # isort: skip (bmesh is found only after bpy)
import bmesh
import numpy as np
import pytest

from lumigate import sample_scenes


def evaluated_meshes():
    """(name, mesh) of every evaluated instance of the open scene."""
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        if instance.object.type == "MESH":
            yield instance.object.name, instance.object.data, np.array(instance.matrix_world)


def triangle_count() -> int:
    return sum(len(data.loops) - 2 * len(data.polygons) for _, data, _ in evaluated_meshes())


def fingerprint() -> str:
    """A hash of all that the evaluated geometry is."""
    digest = hashlib.sha256()
    for name, data, matrix in evaluated_meshes():
        points = np.empty(3 * len(data.vertices), np.float32)
        data.vertices.foreach_get("co", points)
        corners = np.empty(len(data.loops), np.int32)
        data.loops.foreach_get("vertex_index", corners)
        for part in (name.encode(), points, corners, matrix):
            digest.update(bytes(part))
    return digest.hexdigest()


@pytest.mark.parametrize("name", sample_scenes.NAMES)
def test_is_complete_and_light_enough_for_tests(name):
    scene = sample_scenes.build(name, detail="low")
    assert scene == bpy.context.scene
    assert scene.camera is not None
    assert 10 < triangle_count() <= 20_000
    for material in bpy.data.materials:
        output = next(node for node in material.node_tree.nodes if node.type == "OUTPUT_MATERIAL")
        assert output.inputs["Surface"].links[0].from_node.type in {"BSDF_PRINCIPLED", "EMISSION", "MIX_SHADER"}, material.name
    assert all(picture.packed_file for picture in bpy.data.images)


@pytest.mark.parametrize("name", sample_scenes.NAMES)
def test_is_the_same_every_time(name):
    sample_scenes.build(name, detail="low")
    first = fingerprint()
    sample_scenes.build(name, detail="low")
    assert fingerprint() == first


@pytest.mark.parametrize("name", sample_scenes.NAMES)
@pytest.mark.parametrize("detail", ["low", "full"])
def test_meshes_are_valid_and_closed(name, detail):
    sample_scenes.build(name, detail=detail)
    for data in bpy.data.meshes:
        assert not data.validate(), f"{data.name} had to be corrected"
        if data.name.startswith("Open "):  # leaves and panes have no thickness
            continue
        solid = bmesh.new()
        solid.from_mesh(data)
        assert all(edge.is_manifold and edge.is_contiguous for edge in solid.edges), data.name
        assert all(face.calc_area() > 1e-10 for face in solid.faces), data.name
        assert (solid.calc_volume(signed=True) > 0) == (data.name != "Furnace"), data.name
        solid.free()


def test_unknown_names_and_details_are_refused():
    with pytest.raises(KeyError, match="atlantis"):
        sample_scenes.build("atlantis")
    with pytest.raises(KeyError):
        sample_scenes.build("cornell", detail="medium")


def test_furnace_radiance_approaches_its_closed_form():
    from lumigate.sample_scenes.furnace import indirect_radiance

    assert indirect_radiance(0.5, 2.0, 0) == 0
    assert indirect_radiance(0.5, 2.0, 1) == pytest.approx(0.5)
    emitted, direct = 2.0, 0.5 * 2.0
    assert emitted + direct + indirect_radiance(0.5, 2.0, 60) == pytest.approx(2.0 / (1 - 0.5))


def test_full_atrium_is_as_detailed_as_a_real_scene():
    sample_scenes.build("atrium")
    assert triangle_count() >= 200_000


@pytest.mark.parametrize("name, inside", [("corridor", (9.0, 0.0, 1.4)), ("cathedral", (10.0, 0.5, 2.0)), ("furnace", (0.2, -0.1, 0.3))])
def test_no_light_leaks_in_or_out(name, inside):
    """From a point indoors every ray, and every bounce after it, meets the front of some surface within the building."""
    scene = sample_scenes.build(name, detail="low")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    rng = np.random.default_rng(0)
    for _ in range(400):
        origin = np.array(inside)
        for _ in range(6):
            direction = rng.normal(size=3)
            direction /= np.linalg.norm(direction)
            hit, location, normal, _, thing, _ = scene.ray_cast(depsgraph, origin, direction)
            assert hit, f"{name}: a ray escapes from {origin} along {direction}"
            if not thing.data.name.startswith("Open "):
                assert np.dot(normal, direction) < 1e-4, f"{name}: the back of {thing.name} is seen at {location}"
            origin = np.array(location) - 1e-3 * direction
