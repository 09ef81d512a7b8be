"""What materials ask of the render that they are in: the camera, and properties of view layer, scene and world."""

import numpy as np
import pytest
from mathutils import Euler

from lumigate.core.surfaces.batch import evaluate_batch
from lumigate.core.surfaces.layout import EMISSION

from .test_extract_attributes import GAIN, OFFSET, emitting


def seen(stage):
    """(256, 3) what a floor emits where the camera's pixels meet it, as it is extracted."""
    scene = stage.extract()
    view, n = scene.camera, 16
    left, right, bottom, top = view.window
    share = (np.arange(n) + 0.5) / n
    x, y = np.meshgrid(left + share * (right - left), top - share * (top - bottom))
    at = np.stack([x, y, np.zeros_like(x)] if view.orthographic else [x, y, -np.ones_like(x)], -1).reshape(-1, 3)
    turn, place = view.matrix[:3, :3], view.matrix[:3, 3] + scene.origin
    start = place + at @ turn.T if view.orthographic else np.broadcast_to(place, at.shape)
    way = np.broadcast_to(-turn[:, 2], at.shape) if view.orthographic else at @ turn.T
    found = start - way * (start[:, 2:] / way[:, 2:])
    corners = (scene.geometry.vertices + scene.origin)[scene.geometry.triangles][0, :, :2]
    uv = np.linalg.solve(np.stack([corners[1] - corners[0], corners[2] - corners[0]], 1), (found[:, :2] - corners[0]).T)
    triangle = np.zeros(len(found), np.int32)
    surfaces = evaluate_batch(
        scene.materials.tables, scene.geometry.material, scene.geometry.attributes, triangle, *uv.astype(np.float32), 0.8
    )
    return surfaces[:, EMISSION : EMISSION + 3]


def shown(stage, tmp_path):
    return stage.radiance(str(tmp_path / "cycles.exr"), 1).reshape(-1, 3)


def floor(stage, node, output, **settings):
    """One large triangle below a camera that leans."""
    ob = stage.mesh("Floor", [(-99, -99, 0), (99, -99, 0), (0, 99, 0)], [(0, 1, 2)])
    emitting(stage, ob, node, output, **settings)
    camera = stage.camera
    camera.location, camera.rotation_euler = (0.3, -1.0, 2.0), Euler((0.5, 0.2, 0.3))
    camera.data.shift_x, camera.data.lens = 0.1, 40
    stage.scene.render.resolution_x = stage.scene.render.resolution_y = 16
    return ob


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize(
    "node, output",
    [
        ("ShaderNodeTexCoord", "Camera"),
        ("ShaderNodeTexCoord", "Window"),
        ("ShaderNodeCameraData", "View Vector"),
        ("ShaderNodeCameraData", "View Z Depth"),
        ("ShaderNodeCameraData", "View Distance"),
    ],
)
def test_the_camera_is_that_of_cycles(stage, tmp_path, node, output, kind):
    floor(stage, node, output)
    stage.camera.data.type, stage.camera.data.ortho_scale = kind, 1.3
    np.testing.assert_allclose((seen(stage) - OFFSET) / GAIN, (shown(stage, tmp_path) - OFFSET) / GAIN, atol=0.02)
    assert not [line for line in stage.extract().warnings if "baked" in line]


@pytest.mark.parametrize("owner", ["layer", "scene", "world", "path", None])
def test_properties_of_the_view_layer(stage, tmp_path, owner):
    name = "render.resolution_x" if owner == "path" else "mood"
    floor(stage, "ShaderNodeAttribute", "Color", attribute_type="VIEW_LAYER", attribute_name=name)
    owners = {"layer": stage.scene.view_layers[0], "scene": stage.scene, "world": stage.world()}
    for k, key in enumerate(owners):
        if owner in owners and list(owners).index(owner) <= k:
            owners[key]["mood"] = (0.1 + 0.3 * k, 0.7, 0.2)
    stage.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0
    np.testing.assert_allclose(seen(stage), shown(stage, tmp_path), atol=1e-3)


@pytest.mark.parametrize(
    "node, output, blind",
    [("ShaderNodeNewGeometry", "Incoming", "right above the surface"), ("ShaderNodeParticleInfo", "Random", "without particles")],
)
def test_what_a_bake_cannot_know_has_a_warning(stage, node, output, blind):
    floor(stage, node, output)
    assert [line for line in stage.extract().warnings if blind in line]


def test_films_have_a_warning(stage):
    ob = floor(stage, "ShaderNodeValue", 0)
    tree = ob.data.materials[0].node_tree
    principled = tree.nodes.new("ShaderNodeBsdfPrincipled")
    principled.inputs["Thin Film Thickness"].default_value = 300
    tree.links.new(principled.outputs[0], next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL").inputs[0])
    assert [line for line in stage.extract().warnings if "thin film" in line]
