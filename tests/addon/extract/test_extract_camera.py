"""The camera's window: every pixel's ray is Blender's own."""

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from lumigate.core.errors import SceneError

CASES = {
    "wide": {},
    "tall": dict(size=(90, 160)),
    "shift": dict(shift_x=0.2, shift_y=-0.3),
    "shift tall": dict(size=(90, 160), shift_x=0.2, shift_y=-0.3),
    "horizontal fit": dict(size=(90, 160), sensor_fit="HORIZONTAL", shift_x=0.1, shift_y=0.4),
    "vertical fit": dict(sensor_fit="VERTICAL", sensor_height=20, shift_x=0.1, shift_y=0.4),
    "pixel aspect": dict(aspect=(1.0, 1.6), shift_x=0.15),
    "pixel aspect tall": dict(aspect=(2.0, 1.0), size=(90, 100), shift_y=0.15),
    "ortho": dict(type="ORTHO", ortho_scale=3.5, shift_x=0.2, shift_y=-0.3),
    "ortho tall": dict(type="ORTHO", ortho_scale=3.5, size=(90, 160), shift_x=0.2, shift_y=-0.3),
    "ortho fit": dict(type="ORTHO", ortho_scale=3.5, sensor_fit="VERTICAL", aspect=(1.3, 1.0), shift_y=0.1),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_projection_is_blenders(stage, case):
    settings = {"lens": 35, "sensor_width": 30, **CASES[case]}
    width, height = settings.pop("size", (160, 90))
    aspect = settings.pop("aspect", (1.0, 1.0))
    for name, value in settings.items():
        setattr(stage.camera.data, name, value)
    render = stage.scene.render
    render.resolution_x, render.resolution_y = 2 * width, 2 * height
    render.resolution_percentage = 50
    render.pixel_aspect_x, render.pixel_aspect_y = aspect
    stage.camera.matrix_world = (
        Matrix.Translation((3, -2, 1)) @ Euler((1.1, 0.3, -0.7)).to_matrix().to_4x4() @ Matrix.Diagonal((2, 2, 3, 1))
    )
    stage.cube()
    scene = stage.extract()
    camera = scene.camera
    assert (camera.width, camera.height, camera.border) == (width, height, (0, 0, width, height))

    points = np.random.default_rng(0).normal((0, 0, -4), size=(50, 3))  # in front of the camera, in its space
    rigid = camera.matrix.copy()
    rigid[:3, 3] += scene.origin
    world = points @ rigid[:3, :3].T + rigid[:3, 3]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    projection = stage.camera.calc_matrix_camera(depsgraph, x=width, y=height, scale_x=aspect[0], scale_y=aspect[1])
    clip = np.c_[world, np.ones(50)] @ np.array(projection @ stage.camera.matrix_world.normalized().inverted()).T
    expected = 0.5 + 0.5 * clip[:, :2] / clip[:, 3:]

    on_plane = points[:, :2] / (1 if camera.orthographic else -points[:, 2:])
    left, right, bottom, top = camera.window
    got = (on_plane - (left, bottom)) / (right - left, top - bottom)
    np.testing.assert_allclose(got, expected, atol=2e-5)


def test_size_replaces_resolution_and_clip_distances_are_kept(stage):
    stage.cube()
    stage.camera.data.clip_start, stage.camera.data.clip_end = 0.25, 77
    camera = stage.extract(size=(40, 20)).camera
    assert (camera.width, camera.height) == (40, 20)
    assert (camera.near, camera.far, camera.name) == (0.25, 77, "Camera")
    left, right, bottom, top = camera.window
    assert (right - left) == pytest.approx(2 * (top - bottom))


def test_border_counts_from_the_top(stage):
    stage.cube()
    render = stage.scene.render
    render.resolution_x, render.resolution_y = 100, 50
    render.use_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.1, 0.5, 0.2, 0.6
    assert stage.extract().camera.border == (10, 20, 50, 40)
    assert render.use_border and render.resolution_x == 100  # the evaluation left them as they were


def test_named_camera_is_taken(stage):
    stage.cube()
    stage.link("Second", bpy.data.cameras.new("Second"), Matrix.Translation((7, 0, 0)))
    scene = stage.extract(camera="Second")
    assert scene.camera.name == "Second"
    assert (scene.camera.matrix[:3, 3] + scene.origin)[0] == pytest.approx(7)


def panoramic(stage, kind):
    """Makes the stage's camera a panoramic one of that kind; what holds its settings."""
    data = stage.camera.data
    data.type = "PANO"
    view = data if hasattr(data, "panorama_type") else data.cycles
    view.panorama_type = kind
    return view


def test_a_panorama_spans_its_longitudes_and_latitudes(stage):
    stage.cube()
    view = panoramic(stage, "EQUIRECTANGULAR")
    view.longitude_min, view.longitude_max, view.latitude_min, view.latitude_max = -1.0, 2.0, -0.5, 1.25
    camera = stage.extract().camera
    assert camera.panorama and not camera.orthographic
    assert camera.window == pytest.approx((-1.0, 2.0, -0.5, 1.25))


@pytest.mark.parametrize(
    ("spoil", "options", "message"),
    [
        (lambda s: setattr(s.scene, "camera", None), {}, "no active camera.*Camera"),
        (lambda s: setattr(s.scene, "camera", s.cube("Box")), {}, "'Box' is no camera"),
        (lambda s: None, {"camera": "Nobody"}, "no camera 'Nobody'.*Camera"),
        (lambda s: panoramic(s, "FISHEYE_EQUIDISTANT"), {}, "'Camera'.*of type fisheye.*perspective, orthographic and equirectangular"),
        (lambda s: setattr(s.camera, "scale", (0, 1, 1)), {}, "'Camera'.*scale of zero"),
        (lambda s: None, {"size": (0, 10)}, "0x10"),
        (lambda s: setattr(s.scene.render, "resolution_percentage", 1), {}, "0x0"),
        (lambda s: [setattr(s.scene.render, k, v) for k, v in dict(use_border=True, border_min_x=0.5, border_max_x=0.501).items()], {}, "holds no pixel"),
        (lambda s: None, {"view_layer": "Nope"}, "no view layer 'Nope'"),
    ],
)  # fmt: skip
def test_what_cannot_be_rendered_says_so(stage, spoil, options, message):
    spoil(stage)
    with pytest.raises(SceneError, match=message):
        stage.extract(**options)


def test_ignored_effects_are_named(stage):
    stage.cube()
    stage.camera.data.dof.use_dof = True
    stage.scene.render.use_motion_blur = True
    warnings = " ".join(stage.extract().warnings)
    assert "depth of field of camera 'Camera'" in warnings
    assert "motion blur of scene 'Scene'" in warnings


def test_frame_is_set_and_read(stage):
    stage.cube()
    stage.camera.keyframe_insert("location", frame=1)
    stage.camera.location.x = 5
    stage.camera.keyframe_insert("location", frame=11)
    scene = stage.extract(frame=11)
    assert scene.frame == 11 == stage.scene.frame_current
    assert (scene.camera.matrix[:3, 3] + scene.origin)[0] == pytest.approx(5)


def test_a_frame_is_set_where_time_is_remapped(stage):
    # Frame 20 was taken for the present one, 10: where time runs twice as fast, 20 is what Blender calls the final frame.
    stage.scene.render.frame_map_old, stage.scene.render.frame_map_new = 100, 50
    stage.scene.frame_set(10)
    assert stage.extract(frame=20).frame == 20
