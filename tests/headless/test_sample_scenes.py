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


@pytest.fixture(scope="module", params=sample_scenes.NAMES)
def light(request):
    """The name of a scene that is open at low detail; pytest runs all tests of one scene before it opens the next."""
    sample_scenes.build(request.param, detail="low")
    return request.param


def test_is_complete_and_light_enough_for_tests(light):
    assert bpy.context.scene.camera is not None
    assert 10 < triangle_count() <= 20_000
    for material in bpy.data.materials:
        output = next(node for node in material.node_tree.nodes if node.type == "OUTPUT_MATERIAL")
        assert output.inputs["Surface"].links[0].from_node.type in {"BSDF_PRINCIPLED", "EMISSION", "MIX_SHADER"}, material.name
    assert all(picture.packed_file for picture in bpy.data.images)


def test_is_the_same_every_time(light):
    first = fingerprint()
    scene = sample_scenes.build(light, detail="low")
    assert scene == bpy.context.scene
    assert fingerprint() == first


def check_meshes():
    """Every mesh of the open file is valid, and closed unless its name begins with Open (leaves, panes)."""
    for data in bpy.data.meshes:
        assert not data.validate(), f"{data.name} had to be corrected"
        if data.name.startswith("Open "):
            continue
        solid = bmesh.new()
        solid.from_mesh(data)
        assert all(edge.is_manifold and edge.is_contiguous for edge in solid.edges), data.name
        assert all(face.calc_area() > 1e-10 for face in solid.faces), data.name
        assert (solid.calc_volume(signed=True) > 0) == (data.name != "Furnace"), data.name
        solid.free()


def test_meshes_are_valid_and_closed(light):
    check_meshes()


INSIDE = {"corridor": (9.0, 0.0, 1.4), "cathedral": (10.0, 0.5, 2.0), "gallery": (4.0, 0.0, 1.5), "furnace": (0.2, -0.1, 0.3)}


@pytest.mark.parametrize("light", INSIDE, indirect=True)
def test_no_light_leaks_in_or_out(light):
    """From a point indoors every ray, and every bounce after it, meets the front of some surface."""
    scene = bpy.context.scene
    depsgraph = bpy.context.evaluated_depsgraph_get()
    rng = np.random.default_rng(0)
    for _ in range(400):
        origin = np.array(INSIDE[light])
        for _ in range(6):
            direction = rng.normal(size=3)
            direction /= np.linalg.norm(direction)
            hit, location, normal, _, thing, _ = scene.ray_cast(depsgraph, origin, direction)
            assert hit, f"a ray escapes from {origin} along {direction}"
            if not thing.data.name.startswith("Open "):
                assert np.dot(normal, direction) < 1e-4, f"the back of {thing.name} is seen at {location}"
            origin = np.array(location) - 1e-3 * direction


@pytest.mark.parametrize(
    "name, triangles", [("atrium", 200_000), ("corridor", 50_000), ("cathedral", 50_000), ("gallery", 50_000), ("window", 30_000)]
)
def test_full_detail_is_that_of_a_real_scene(name, triangles):
    sample_scenes.build(name)
    assert triangle_count() >= triangles
    check_meshes()


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


def test_windows_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="does not fit"):
        sample_scenes.build("window", detail="low", width=4.0)


def test_gallery_has_the_lamps_it_promises():
    sample_scenes.build("gallery", detail="low")
    assert sum(thing.type == "LIGHT" for thing in bpy.data.objects) == 200
