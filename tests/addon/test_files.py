"""Opening of scene files, whole and broken."""

import bpy
import numpy as np
import pytest
from mathutils import Vector

from lumigate.addon.extract import extract_scene
from lumigate.addon.files import open_scene
from lumigate.core.errors import SceneError

OBJ = """mtllib box.mtl
v 10 0 0
v 14 0 0
v 14 0 -4
v 10 3 0
usemtl Red
f 1 2 3
f 1 2 4
"""
MTL = "newmtl Red\nKd 1 0 0\n"


@pytest.fixture
def obj(tmp_path):
    (tmp_path / "box.mtl").write_text(MTL)
    path = tmp_path / "box.obj"
    path.write_text(OBJ)
    return path


def empty():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def assert_framed(scene):
    """Every corner of every mesh is in the picture, and not as a speck."""
    arrays = extract_scene(scene, size=(160, 90))
    camera = arrays.camera
    local = (arrays.geometry.vertices - camera.matrix[:3, 3]) @ camera.matrix[:3, :3]
    depth = -local[:, 2]
    assert (depth > camera.near).all() and (depth < camera.far).all()
    left, right, bottom, top = camera.window
    x, y = local[:, 0] / depth, local[:, 1] / depth
    assert left < x.min() and x.max() < right and bottom < y.min() and y.max() < top
    assert max(np.ptp(x) / (right - left), np.ptp(y) / (top - bottom)) > 0.2


def test_blend_file_opens_as_saved_and_runs_no_script(tmp_path):
    scene = empty()
    scene.name = "Saved"
    text = bpy.data.texts.new("run.py")
    text.write("import bpy\nbpy.context.scene.name = 'Hijacked'\n")
    text.use_module = True
    path = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    empty()
    assert open_scene(path).name == "Saved"
    assert bpy.context.scene.name == "Saved"


def test_obj_comes_with_its_material_and_a_camera_that_frames_it(obj):
    scene = open_scene(obj)
    assert scene.camera is not None
    arrays = extract_scene(scene)
    assert len(arrays.geometry.triangles) == 2 and arrays.materials.names == ["Red"]
    assert_framed(scene)


def test_a_missing_material_library_is_named(obj):
    assert not [line for line in extract_scene(open_scene(obj)).warnings if "library" in line]
    obj.write_text("# mtllib of nothing\n" + obj.read_text().replace("mtllib ", "mtllib no such "))
    (warning,) = (line for line in extract_scene(open_scene(obj)).warnings if "library" in line)
    assert warning.startswith(f"'{obj.name}' names the material library 'no such ") and warning.endswith("its materials are grey")


@pytest.mark.parametrize("shining", [False, True])
def test_a_model_without_light_is_lit_by_a_sky(obj, shining):
    if shining:
        (obj.parent / "box.mtl").write_text(MTL + "Ke 1 1 1\n")
    arrays = extract_scene(open_scene(obj))
    assert [line for line in arrays.warnings if "sky" in line] == (
        [] if shining else ["'box.obj' brings no light: an even white sky of radiance 1 lights it"]
    )
    np.testing.assert_allclose(arrays.world.radiance.reshape(-1, 3), [[0, 0, 0] if shining else [1, 1, 1]])


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_gltf_comes_with_its_meshes_lights_and_camera(tmp_path, suffix):
    scene = empty()
    bpy.ops.mesh.primitive_cube_add()
    scene.collection.objects.link(bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT")))
    camera = bpy.data.objects.new("Eye", bpy.data.cameras.new("Eye"))
    camera.location = 0, 0, 9
    scene.collection.objects.link(camera)
    path = tmp_path / f"scene{suffix}"
    kind = "GLB" if suffix == ".glb" else "GLTF_SEPARATE"
    bpy.ops.export_scene.gltf(filepath=str(path), export_format=kind, export_lights=True, export_cameras=True)
    opened = open_scene(path)
    assert opened.camera.name.startswith("Eye")
    assert (opened.camera.matrix_world.translation - Vector((0, 0, 9))).length < 1e-5
    arrays = extract_scene(opened)
    assert len(arrays.geometry.triangles) == 12 and len(arrays.lamps) == 1


def test_gltf_without_camera_is_framed(tmp_path):
    empty()
    bpy.ops.mesh.primitive_cube_add(location=(50, 0, 0), scale=(1, 8, 1))
    path = tmp_path / "box.glb"
    bpy.ops.export_scene.gltf(filepath=str(path))
    assert_framed(open_scene(path))


@pytest.mark.parametrize("suffix", [".blend", ".glb", ".gltf", ".obj"])
def test_missing_file(tmp_path, suffix):
    with pytest.raises(SceneError, match=r"no such file.*nowhere"):
        open_scene(tmp_path / f"nowhere{suffix}")


@pytest.mark.parametrize("suffix", [".blend", ".glb", ".gltf", ".obj"])
@pytest.mark.parametrize("content", [b"", b"\x00\xffnot a scene\n" * 50])
def test_damaged_file(tmp_path, suffix, content):
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(content)
    with pytest.raises(SceneError) as raised:
        open_scene(path)
    assert "damaged" in str(raised.value) and "\n" not in str(raised.value)


def test_unsupported_file(tmp_path):
    path = tmp_path / "scene.fbx"
    path.write_bytes(b"")
    with pytest.raises(SceneError, match=r"fbx.*\.blend, \.glb"):
        open_scene(path)


def test_folder_is_no_file(tmp_path):
    (tmp_path / "scene.blend").mkdir()
    with pytest.raises(SceneError, match="no such file"):
        open_scene(tmp_path / "scene.blend")


def test_file_without_faces(tmp_path):
    path = tmp_path / "points.obj"
    path.write_text("v 0 0 0\nv 1 0 0\n")
    with pytest.raises(SceneError, match=r"points\.obj' holds no faces"):
        open_scene(path)


def marks(path):
    bpy.context.view_layer.update()
    return sorted(found.name for found in path.parent.glob("was here*"))


@pytest.fixture
def strangers_file(tmp_path):
    """A .blend whose registered text and whose driver each write a file, if they may."""
    mark = tmp_path / "was here"
    scene = empty()
    scene.camera = bpy.data.objects.new("Driven", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    text = bpy.data.texts.new("startup.py")
    text.use_module = True
    text.write(f"open({str(mark)!r} + ' text', 'w').close()")
    driver = bpy.data.objects["Driven"].driver_add("location", 0).driver
    driver.expression = f"len(str(open({str(mark)!r} + ' driver', 'w')))"
    path = tmp_path / "stranger.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert marks(path) == []
    return path


def test_a_file_from_a_stranger_runs_no_code(strangers_file):
    before = set(strangers_file.parent.iterdir())
    extract_scene(open_scene(strangers_file), size=(8, 8))
    assert marks(strangers_file) == [] and set(strangers_file.parent.iterdir()) == before
    # The same file, trusted, does run it.
    bpy.ops.wm.open_mainfile(filepath=str(strangers_file), use_scripts=True, load_ui=False)
    assert "was here text" in marks(strangers_file)
    empty()
