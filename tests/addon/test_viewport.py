"""The camera of a viewport is the one of a render through the same eye; drawing itself is tested in a window (tests/gui)."""

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Matrix

import lumigate
from lumigate import sample_scenes
from lumigate.addon.extract import extract_scene, extract_shown
from lumigate.addon.region import WHOLE, part_of, pixels_of, region_camera, render_region
from lumigate.addon.viewport import Viewport, viewport_settings

SIZE = 64, 40


def seen_from(scene, **camera):
    """The camera object's own arrays, and those of a region that looks through it."""
    eye = scene.camera
    for name, value in camera.items():
        setattr(eye.data, name, value)
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    graph = bpy.context.evaluated_depsgraph_get()
    projection = eye.calc_matrix_camera(graph, x=SIZE[0], y=SIZE[1])
    shown = region_camera(eye.matrix_world.inverted(), projection, *SIZE)
    return extract_scene(scene), shown


@pytest.mark.parametrize("camera", [{"lens": 35, "shift_x": 0.2, "shift_y": -0.1}, {"type": "ORTHO", "ortho_scale": 3.0, "shift_x": 0.1}])
def test_a_region_sees_what_the_camera_sees(camera):
    scene = sample_scenes.build("cornell", detail="low")
    arrays, shown = seen_from(scene, **camera)
    wanted = arrays.camera
    assert (shown.orthographic, shown.width, shown.height, shown.border) == (wanted.orthographic, *SIZE, (0, 0, *SIZE))
    np.testing.assert_allclose(shown.window, wanted.window, rtol=1e-4, atol=1e-5)
    assert shown.far - shown.near == pytest.approx(wanted.far - wanted.near, rel=1e-3)
    near = shown.near - wanted.near  # an orthographic region's eye stands on its near plane
    placed = wanted.matrix[:3, 3] + arrays.origin + near * wanted.matrix[:3, 2]
    np.testing.assert_allclose(shown.matrix[:3, :3], wanted.matrix[:3, :3], atol=1e-5)
    np.testing.assert_allclose(shown.matrix[:3, 3], placed, atol=1e-4)


def test_the_render_region_of_the_camera_is_the_same_part_of_its_frame():
    scene = sample_scenes.build("cornell", detail="low")
    seen_from(scene, lens=35, shift_x=0.2, sensor_fit="VERTICAL")
    eye, graph = scene.camera, bpy.context.evaluated_depsgraph_get()
    projection = eye.calc_matrix_camera(graph, x=SIZE[0], y=SIZE[1])
    region = SimpleNamespace(width=2 * SIZE[0], height=2 * SIZE[1])
    space = SimpleNamespace(use_local_camera=False, use_render_border=False)
    # The frame takes the middle half of the region: to a projection, x and y are half as large.
    half = np.diag([0.5, 0.5, 1, 1]) @ np.array(projection) @ np.array(eye.matrix_world.inverted())
    view = SimpleNamespace(view_perspective="CAMERA", perspective_matrix=Matrix(half.tolist()))
    assert render_region(scene, space, view, region) == WHOLE
    render = scene.render
    render.use_border, render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = True, 0.5, 1.0, 0.0, 0.25
    np.testing.assert_allclose(render_region(scene, space, view, region), (0.5, 0.25, 0.75, 0.375), atol=1e-4)


def test_the_render_region_of_a_free_view_is_its_own():
    scene = bpy.context.scene
    scene.render.use_border = True  # of the camera alone
    view = SimpleNamespace(view_perspective="PERSP")
    edges = {"render_border_min_x": 0.1, "render_border_min_y": 0.2, "render_border_max_x": 0.3, "render_border_max_y": 0.4}
    spaces = [SimpleNamespace(use_local_camera=False, use_render_border=used, **edges) for used in (False, True)]
    assert [render_region(scene, space, view, None) for space in spaces] == [WHOLE, (0.1, 0.2, 0.3, 0.4)]


def test_pixels_of_a_render_region():
    assert pixels_of(WHOLE, 16, 10) == (0, 0, 16, 10)
    assert pixels_of((0.5, 0.25, 0.75, 0.5), 16, 8) == (8, 4, 12, 6)
    assert part_of((8, 4, 12, 6), 16, 8) == (0.5, 0.25, 0.75, 0.5)
    assert pixels_of((1.0, 1.0, 1.0, 1.0), 16, 8) == (15, 0, 16, 1)  # out of the region: one pixel


def test_what_a_viewport_shows_is_extracted_without_a_render():
    scene = sample_scenes.build("cornell", detail="low")
    arrays, camera = seen_from(scene)
    shown = extract_shown(bpy.context.evaluated_depsgraph_get(), camera)
    np.testing.assert_array_equal(shown.geometry.triangles, arrays.geometry.triangles)
    np.testing.assert_allclose(shown.camera.matrix, arrays.camera.matrix, atol=1e-4)
    assert "Render Result" not in bpy.data.images or not bpy.data.images["Render Result"].has_data


def test_the_local_view_shows_its_objects_only():
    bpy.ops.wm.read_factory_settings()  # with a window
    scene = bpy.context.scene
    scene.collection.objects.link(bpy.data.objects.new("Other", bpy.data.objects["Cube"].data))
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    for ob in scene.objects:
        ob.select_set(ob.name == "Cube")
    bpy.context.view_layer.objects.active = scene.objects["Cube"]
    camera = seen_from(scene)[1]

    def shown():
        arrays = extract_shown(bpy.context.evaluated_depsgraph_get(), camera, area.spaces.active)
        return arrays.geometry.object_names, arrays.lamps.names

    assert shown() == (["Cube", "Other"], ["Light"])
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.view3d.localview()
    bpy.context.view_layer.update()
    assert shown() == (["Cube"], [])


def test_the_viewport_sees_through_a_transparent_film():
    lumigate.register()
    try:
        scene = sample_scenes.build("cornell", detail="low")
        scene.objects["Tall block"].is_holdout = True
        camera = seen_from(scene)[1]
        viewport = Viewport()
        viewport._scene = extract_shown(bpy.context.evaluated_depsgraph_get(), camera)
        viewport._eye = SimpleNamespace(width=SIZE[0], height=SIZE[1])
        viewport._camera = lambda _pixel: replace(
            viewport._scene.camera, matrix=viewport._scene.camera.matrix.copy(), border=(0, 10, 64, 30)
        )
        for transparent in (True, False):
            scene.render.film_transparent = transparent
            viewport._settings = viewport_settings(scene)
            viewport._restart()
            job = viewport._job = viewport._begin()
            assert job.wait(600) and job.error is None  # the first one compiles
            viewport._collect()
            alpha = viewport._picture[..., 3]
            assert alpha.max() == 1 and (alpha.min() == 0) == transparent
            assert alpha.shape == (20, 64) and viewport._part == (0, 0.25, 1, 0.75)
    finally:
        lumigate.unregister()
