"""Bad input ends in one clear line and status 2, or in a warning beside a picture; never in part of a file."""

import json
import resource
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np
import pytest

from lumigate.core.layers import Layers, read_exr, write_exr, write_picture
from lumigate.headless.cli import main
from lumigate.headless.outputs import whole_folder

SMALL = ["--size", "8x8", "--vpls", "4", "--pixel-samples", "1", "--bounces", "1"]


@pytest.fixture
def run(capsys):
    """Runs the command line in this process: status, lines of stdout, lines of stderr."""

    def run(*argv) -> tuple[int, list[str], list[str]]:
        status = main([str(word) for word in argv])
        out, err = capsys.readouterr()
        return status, out.splitlines(), err.splitlines()

    return run


def assert_refused(result, *words: str) -> None:
    """Status 2 and one line on stderr that holds `words`."""
    status, out, err = result
    assert (status, out, len(err)) == (2, [], 1), err
    assert err[0].startswith("lumigate: error: ")
    for word in words:
        assert word in err[0]


@pytest.fixture
def scene_file(tmp_path, capsys):
    """Saves a floor, a lamp and a camera above, after an edit, and gives the .blend's path."""

    def save(edit=lambda scene: None) -> Path:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        add(scene, "Floor", floor_mesh())
        lamp = add(scene, "Lamp", bpy.data.lights.new("Lamp", "POINT"))
        lamp.location = (0, 0, 2)
        lamp.data.energy = 100
        camera = add(scene, "Camera", bpy.data.cameras.new("Camera"))
        camera.location = (0, 0, 4)
        scene.camera = camera
        edit(scene)
        folder = tmp_path / "scene"
        folder.mkdir(exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
        capsys.readouterr()
        return folder / "scene.blend"

    return save


def add(scene, name, data):
    ob = bpy.data.objects.new(name, data)
    scene.collection.objects.link(ob)
    return ob


def floor_mesh(corners=((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0))):
    mesh = bpy.data.meshes.new("Floor")
    mesh.from_pydata(corners, [], [range(len(corners))] if corners else [])
    return mesh


@pytest.fixture
def render(run, tmp_path):
    """Renders a scene file small, into a folder that must stay empty where the render is refused: the result of `run` and the stats."""

    def render(scene, *options):
        folder = tmp_path / "out"
        folder.mkdir()
        status, out, err = run("render", scene, "-o", folder / "out.exr", "--stats", folder / "stats.json", *SMALL, *options)
        if status:
            assert list(folder.iterdir()) == []
            return (status, out, err), None
        assert sorted(path.name for path in folder.iterdir()) == ["out.exr", "stats.json"]
        return (status, out, err), json.loads((folder / "stats.json").read_text())

    return render


def warned(stats: dict, *words: str) -> bool:
    """Whether one warning holds all of `words`."""
    return any(all(word in line for word in words) for line in stats["warnings"])


# What the arguments alone can tell.


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ([], ["COMMAND"]),
        (["paint"], ["paint", "render"]),
        (["render", "no-such-scene.blend", "-o", "OUT"], ["no-such-scene.blend", "check the path"]),
        (["render", "scene.fbx", "-o", "OUT"], ["scene.fbx", ".blend", "cornell"]),
        (["render", "cornell"], ["-o"]),
        (["render", "cornell", "-o", "OUT", "--size", "640"], ["--size", "1280x720"]),
        (["render", "cornell", "-o", "OUT", "--size", "0x480"], ["--size", "0x480"]),
        (["render", "cornell", "-o", "OUT", "--size", "99999x2"], ["--size", "65536"]),
        (["render", "cornell", "-o", "OUT", "--method", "magic"], ["--method", "instant-radiosity"]),
        (["render", "cornell", "-o", "OUT", "--vpls", "-5"], ["--vpls", "from 1 up"]),
        (["render", "cornell", "-o", "OUT", "--vpls", "many"], ["--vpls", "many"]),
        (["render", "cornell", "-o", "OUT", "--pixel-samples", "0"], ["--pixel-samples"]),
        (["render", "cornell", "-o", "OUT", "--downsampling", "0"], ["--downsampling", "from 1 up"]),
        (["render", "cornell", "-o", "OUT", "--seed", "-1"], ["--seed"]),
        (["render", "cornell", "-o", "OUT", "--time-budget", "nan"], ["--time-budget", "above 0"]),
        (["render", "cornell", "-o", "OUT", "--time-budget", "1", "--target-error", "1"], ["--target-error", "not allowed with"]),
        (["render", "cornell", "-o", "OUT", "--frame", "2000000"], ["--frame", "1048574"]),
        (["render", "cornell", "-o", "OUT", "--frames", "9-2"], ["--frames", "2-9"]),
        (["compare", "a.exr", "b.exr"], ["a.exr", "check the path"]),
        (["inspect", "cornell", "--outside", "open"], ["--outside", "--topology"]),
        (["inspect", "cornell", "--sheets", "open"], ["--sheets", "--topology"]),
        (["bake", "cornell", "-o", "maps", "--no-light-groups"], ["--no-light-groups"]),
        (["bake", "cornell", "-o", "maps", "--interleave", "2"], ["--interleave"]),
        (["bake", "cornell", "-o", "maps", "--attributes", "--atlas"], ["--atlas", "--attributes"]),
    ],
)
def test_wrong_arguments_are_named(run, tmp_path, argv, words):
    out = tmp_path / "out.exr"
    assert_refused(run(*[out if word == "OUT" else word for word in argv]), *words)
    assert list(tmp_path.iterdir()) == []


def test_missing_output_folder(run, tmp_path):
    assert_refused(run("render", "cornell", "-o", tmp_path / "nowhere" / "out.exr"), "nowhere", "make it first")


def test_output_that_is_a_folder(run, tmp_path):
    (tmp_path / "out.exr").mkdir()
    assert_refused(run("render", "cornell", "-o", tmp_path / "out.exr"), "is a folder")


def test_names_that_no_disk_can_hold(run, tmp_path):
    # A fault, or found out when the picture was done.
    for option, name in (("render", "x" * 300 + ".exr"), ("bake", "x" * 300)):
        assert_refused(run(option, "cornell", "-o", tmp_path / name), "File name too long", "another name")
    assert_refused(run("render", "x" * 300 + ".blend", "-o", tmp_path / "out.exr"), "there is no file")
    assert_refused(run("compare", "x" * 300, "x" * 300), "there is no file")


def test_the_longest_name_of_an_output_holds(tmp_path):
    path = tmp_path / ("ü" * 125 + ".exr")
    assert write_picture(path, np.zeros((2, 2, 3), np.float32)) == path
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_files_for_a_folder_that_is_there_are_made_in_it(tmp_path):
    # Made beside it they could not be moved into a folder of another disk, as those are that a container mounts.
    with whole_folder(tmp_path) as folder:
        assert folder.parent == tmp_path
        (folder / "map.exr").write_text("")
    assert [file.name for file in tmp_path.iterdir()] == ["map.exr"]
    with whole_folder(tmp_path / "made" / "here") as folder:
        (folder / "map.exr").write_text("")
    assert [file.name for file in (tmp_path / "made").iterdir()] == ["here"]


def test_output_of_another_format(run, tmp_path):
    assert_refused(run("render", "cornell", "-o", tmp_path / "out.png"), "out.png", ".exr")


def test_folder_under_a_file(run, tmp_path):
    (tmp_path / "file").write_text("")
    assert_refused(run("demo", "-o", tmp_path / "file" / "demo"), "is a file")


def test_read_only_folder(run):
    # Nothing can be created in /proc, whoever asks.
    assert_refused(run("render", "cornell", "-o", "/proc/out.exr"), "/proc", "another folder")


# What Blender tells when it opens the scene.


def test_corrupt_blend(render, tmp_path):
    (tmp_path / "bad.blend").write_bytes(b"BLENDER-v405" + b"garbage" * 100)
    assert_refused(render(tmp_path / "bad.blend")[0], "bad.blend")


def test_corrupt_gltf(render, tmp_path):
    (tmp_path / "bad.glb").write_bytes(b"glTF" + bytes(100))
    assert_refused(render(tmp_path / "bad.glb")[0], "bad.glb")


def test_model_without_faces(render, tmp_path):
    (tmp_path / "empty.obj").write_text("v 0 0 0\nv 1 0 0\n")
    assert_refused(render(tmp_path / "empty.obj")[0], "empty.obj", "faces")


def test_no_camera(render, scene_file):
    assert_refused(render(scene_file(lambda scene: setattr(scene, "camera", None)))[0], "camera", "Camera")


def test_unknown_camera(render, scene_file):
    assert_refused(render(scene_file(), "--camera", "Nobody")[0], "Nobody", "Camera")


def test_camera_that_is_none(render, scene_file):
    assert_refused(render(scene_file(), "--camera", "Lamp")[0], "Lamp", "Camera")


def test_panoramic_camera(render, scene_file):
    assert_refused(render(scene_file(lambda scene: setattr(scene.camera.data, "type", "PANO")))[0], "Camera", "pano")


def test_camera_without_size(render, scene_file):
    assert_refused(render(scene_file(lambda scene: setattr(scene.camera, "scale", (0, 0, 0))))[0], "Camera", "scale")


def test_empty_render_region(render, scene_file):
    def edit(scene):
        scene.render.use_border = True
        scene.render.border_min_x, scene.render.border_max_x = 0.5, 0.5

    assert_refused(render(scene_file(edit))[0], "region")


# What is rendered all the same, with a warning.


def test_no_light(render, scene_file):
    (status, _, err), stats = render(scene_file(lambda scene: scene.objects["Lamp"].data.__setattr__("energy", 0)))
    assert status == 0
    assert warned(stats, "light", "add a lamp")
    assert any("add a lamp" in line for line in err)


def test_no_geometry(render, scene_file):
    (status, _, _), stats = render(scene_file(lambda scene: bpy.data.objects.remove(scene.objects["Floor"])))
    assert status == 0
    assert warned(stats, "no triangle")


def test_vertices_that_are_no_numbers(render, scene_file, tmp_path):
    def edit(scene):
        corners = [(-1, -1, 1), (1, -1, 1), (1, 1, float("nan")), (-1, 1, float("inf"))]
        add(scene, "Torn", floor_mesh(corners))

    (status, _, _), stats = render(scene_file(edit))
    assert status == 0
    assert warned(stats, "Torn")
    layers = read_exr(tmp_path / "out" / "out.exr")
    assert all(np.isfinite(array).all() for array in layers.values())


def test_singular_matrix(render, scene_file):
    def edit(scene):
        add(scene, "Flat", floor_mesh()).scale = (1, 0, 0)

    (status, _, _), stats = render(scene_file(edit))
    assert status == 0
    assert warned(stats, "Flat")


def test_empty_mesh(render, scene_file):
    (status, _, _), stats = render(scene_file(lambda scene: add(scene, "Nothing", floor_mesh(()))))
    assert status == 0
    assert stats["vpls"] >= 0


def image_on_floor(scene, image) -> None:
    material = bpy.data.materials.new("Painted")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = image
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    scene.objects["Floor"].data.materials.append(material)


def test_missing_texture(render, scene_file):
    def edit(scene):
        image = bpy.data.images.new("Lost", 4, 4)
        image.source, image.filepath = "FILE", "//lost.png"
        image_on_floor(scene, image)

    (status, _, _), stats = render(scene_file(edit))
    assert status == 0
    assert warned(stats, "lost.png") or warned(stats, "Lost")


def test_image_without_pixels(render, scene_file):
    def edit(scene):
        (Path(bpy.app.tempdir) / "empty.png").write_bytes(b"")
        image_on_floor(scene, bpy.data.images.load(str(Path(bpy.app.tempdir) / "empty.png")))

    (status, _, _), stats = render(scene_file(edit))
    assert status == 0
    assert warned(stats, "empty.png")


# Pictures that cannot be compared.


@pytest.fixture
def picture(tmp_path):
    def write(name: str, **layers) -> Path:
        return write_exr(tmp_path / name, Layers(layers))

    return write


def test_pictures_of_different_size(run, picture):
    a, b = picture("a.exr", Indirect=np.ones((4, 4, 3))), picture("b.exr", Indirect=np.ones((4, 5, 3)))
    assert_refused(run("compare", a, b), "4x4", "5x4")


def test_too_few_addresses(run, tmp_path, monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _kind: (3 << 29, 3 << 29))
    assert_refused(run("render", "cornell", "-o", tmp_path / "out.exr"), "1.5 GiB", "1.8", "ulimit -v")


@pytest.mark.parametrize("role", ["--half", "--against"])
def test_further_pictures_of_different_size(run, picture, role):
    a, b = picture("a.exr", Indirect=np.ones((4, 4, 3))), picture("b.exr", Indirect=np.ones((8, 8, 3)))
    assert_refused(run("compare", a, a, role, b), "4x4", "8x8")


def test_missing_layer(run, picture):
    a, b = picture("a.exr", Indirect=np.ones((4, 4, 3))), picture("b.exr", Albedo=np.ones((4, 4, 3)))
    assert_refused(run("compare", a, b), "b.exr", "Indirect", "Albedo")


def test_picture_that_is_none(run, picture, tmp_path):
    (tmp_path / "b.exr").write_text("no picture")
    assert_refused(run("compare", picture("a.exr", Indirect=np.ones((4, 4, 3))), tmp_path / "b.exr"), "b.exr")


def test_invalid_pixels_are_counted(run, picture, tmp_path):
    torn = np.ones((4, 4, 3))
    torn[0, 0] = np.nan
    status, _, _ = run(
        "compare", picture("a.exr", Indirect=torn), picture("b.exr", Indirect=np.ones((4, 4, 3))), "--json", tmp_path / "c.json"
    )
    assert status == 0
    assert json.loads((tmp_path / "c.json").read_text())["invalid"] == 1


# A disk that fills while the file is written.


@contextmanager
def full_disk():
    """No file can grow beyond 4 KiB, as on a full disk; pytest's own log neither, so only around the call."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_full_disk(render, scene_file):
    scene = scene_file()
    with full_disk():
        result, _ = render(scene, "--size", "64x64")
    assert_refused(result, "out.exr", "cannot write", "free space")
