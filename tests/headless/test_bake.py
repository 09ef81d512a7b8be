"""`lumigate bake`: what it leaves, what it refuses, and its light against Cycles' bake of the same texels."""

import json
from types import SimpleNamespace

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

from lumigate import sample_scenes
from lumigate.addon.lightmaps import LightmapRequest, choose_objects, prepare
from lumigate.core import metrics
from lumigate.core.settings import BakeSettings, RenderSettings
from lumigate.core.view.texels import LIT, Charts
from lumigate.headless.cli import main
from lumigate.headless.cycles_bake import bake_by_cycles
from lumigate.headless.lightmap_bench import chart_image, comparable, lightmap_rows, round_trip_row

SMALL = ["--vpls", "64", "--bounces", "1", "--texel-samples", "1"]


def read(path):
    """(H, W, C) values of an image file."""
    image = oiio.ImageInput.open(str(path))
    pixels = image.read_image(0, 0, 0, 3, oiio.FLOAT)
    image.close()
    return pixels


@pytest.fixture
def box_file(tmp_path):
    """A .blend with a box on a floor under a lamp, the floor selected; no camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 0.5))
    bpy.context.object.name = "Box/1"
    bpy.ops.mesh.primitive_plane_add(size=4)
    bpy.context.object.name = "Floor"
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.location, lamp.data.energy = (1, 1, 3), 100
    bpy.context.scene.collection.objects.link(lamp)
    (tmp_path / "in").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "in" / "scene.blend"))
    return tmp_path / "in" / "scene.blend"


def test_one_image_each_a_list_and_the_scene_with_its_maps(box_file, tmp_path, capsys):
    folder, stats = tmp_path / "out", tmp_path / "stats.json"
    capsys.readouterr()
    assert main(["bake", str(box_file), "-o", str(folder), "--size", "24", "--stats", str(stats), *SMALL]) == 0
    out, err = capsys.readouterr()
    assert out.count("\n") == 1 and "2 lightmaps of 2 objects" in out and not err
    assert sorted(path.name for path in folder.iterdir()) == ["Box_1.exr", "Floor.exr", "lightmaps.json", "scene.blend"]
    listed = json.loads((folder / "lightmaps.json").read_text())
    assert listed["content"] == "irradiance" and "W/m^2" in listed["unit"]
    floor = next(entry for entry in listed["images"] if entry["objects"] == ["Floor"])
    assert floor == {
        "objects": ["Floor"], "uv_map": "Lightmap", "name": "Floor", "file": "Floor.exr", "size": [24, 24], "encoding": "linear", "scale": 1.0
    }  # fmt: skip
    image = read(folder / "Floor.exr")
    assert image.shape == (24, 24, 3) and image.max() > 0.5 and (image >= 0).all()
    assert json.loads(stats.read_text())["texels"]["lit"] > 24 * 24
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    assert all("Lightmap" in ob.data.uv_layers for ob in bpy.data.objects if ob.type == "MESH")


def test_the_selected_object_in_bytes_with_their_scale(box_file, tmp_path):
    for kind in ("exr", "png"):
        options = ["--selected", "--format", kind, "--texel-density", "6", "--no-denoise"]
        assert main(["bake", str(box_file), "-o", str(tmp_path / kind), *options, *SMALL]) == 0
    listed = json.loads((tmp_path / "png" / "lightmaps.json").read_text())["images"]
    assert [entry["objects"] for entry in listed] == [["Floor"]] and listed[0]["encoding"] == "sRGB"
    assert listed[0]["size"][0] == pytest.approx(24, abs=6)
    encoded = read(tmp_path / "png" / "Floor.png")
    decoded = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4) * listed[0]["scale"]
    exact = read(tmp_path / "exr" / "Floor.exr")
    assert np.abs(decoded - exact).max() < 0.01 * exact.max()


def test_attributes_are_in_the_scene(box_file, tmp_path, capsys):
    folder = tmp_path / "out"
    capsys.readouterr()
    assert main(["bake", str(box_file), "-o", str(folder), "--objects", "Floor", "--attributes", *SMALL]) == 0
    assert "1 object in the colour attribute 'Lightmap Color'" in capsys.readouterr().out
    assert [path.name for path in folder.iterdir()] == ["scene.blend"]
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    light = np.array([corner.color[:3] for corner in bpy.data.objects["Floor"].data.color_attributes["Lightmap Color"].data])
    assert light.shape == (4, 3) and (light > 0.1).all()
    assert not bpy.data.objects["Box/1"].data.color_attributes


def test_gltf_has_the_light_on_its_second_uv_map(box_file, tmp_path):
    folder = tmp_path / "out"
    assert main(["bake", str(box_file), "-o", str(folder), "--size", "32", "--atlas", "--content", "full", "--gltf", *SMALL]) == 0
    data = (folder / "scene.glb").read_bytes()
    gltf = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    for mesh in gltf["meshes"]:
        material = gltf["materials"][mesh["primitives"][0]["material"]]
        coordinate = material["emissiveTexture"].get("texCoord", 0)
        assert f"TEXCOORD_{coordinate}" in mesh["primitives"][0]["attributes"] and coordinate > 0
    assert "lights" not in str(gltf.get("extensions", {}))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--objects", "Chair"], ["no object 'Chair'", "Floor"]),
        (["--objects", "Lamp"], ["'Lamp' has no faces"]),
        (["--objects", ","], ["names nothing"]),
        (["--objects", "Floor", "--selected"], ["not allowed with"]),
        (["--size", "0"], ["from 1 up"]),
        (["--size", "99999"], ["99999", "16384"]),
        (["--texel-density", "-2"], ["not a number above 0"]),
        (["--texel-density", "1e6", "--objects", "Floor"], ["'Floor' needs", "choose fewer"]),
        (["--texel-samples", "17"], ["16"]),
        (["--gltf"], ["--content full"]),
        (["--method", "radiosity"], ["invalid choice"]),
        (["--uv-map", "UVMap", "--objects", "Squashed"], ["'Squashed'", "UVMap"]),
    ],
)
def test_bad_input_is_one_line_and_no_folder(box_file, tmp_path, capsys, options, words):
    bpy.ops.wm.open_mainfile(filepath=str(box_file))
    bpy.ops.mesh.primitive_cube_add(location=(9, 0, 0))
    bpy.context.object.name = "Squashed"
    layer = bpy.context.object.data.uv_layers["UVMap"]
    layer.data.foreach_set("uv", np.zeros(2 * len(layer.data), np.float32))
    bpy.ops.wm.save_mainfile()
    capsys.readouterr()
    status = main(["bake", str(box_file), "-o", str(tmp_path / "out"), *SMALL, *options])
    out, err = capsys.readouterr()
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert all(word in err for word in words), err
    assert not (tmp_path / "out").exists() and [path.name for path in tmp_path.iterdir()] == ["in"]


def test_a_failed_write_leaves_what_was_there(box_file, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "Floor.exr").write_text("older")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lumigate.headless.commands.bake.write_lightmap", fail)
    assert main(["bake", str(box_file), "-o", str(folder), "--size", "8", *SMALL]) == 2
    assert (folder / "Floor.exr").read_text() == "older"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "out"]


@pytest.mark.slow
@pytest.mark.parametrize("content", ["irradiance", "indirect"])
def test_light_is_that_of_cycles(content):
    # The same texels by both. Thresholds: the bound plus what the halves' difference says about the reference's noise.
    scene = sample_scenes.build("cornell", detail="low")
    objects = choose_objects(scene)
    settings = BakeSettings(RenderSettings(bounces=4, seed=3), content)
    prepared = prepare(scene, objects, LightmapRequest(settings, size=96, atlas=True))
    baked, (target,) = prepared.run(), prepared.targets
    lightmap = baked.result.lightmaps[0]
    a, b = (bake_by_cycles(scene, objects, baked.layer, (96, 96), content=content, samples=96, seed=seed)[0] for seed in (1, 2))
    lit = comparable(
        lightmap.state, chart_image(prepared.arrays.geometry, Charts.of(target.triangles, target.uv, target.size), target.size)
    )
    test, a, b = (image[lit][None].astype(np.float32) for image in (lightmap.image, a, b))
    mean = (a + b) / 2
    noise = (a - b).mean(axis=2).std() / 2 / np.sqrt(lit.sum()) / mean.mean()
    assert noise < 0.01
    assert abs(metrics.bias(test, mean)) < 0.015 + 2 * noise
    assert metrics.net_relmse(test, a, b) < 0.04  # .022 measured, most of it in edges of charts
    assert not ((test.max(axis=2) < 0.01 * mean.mean()) & (mean.max(axis=2) > 0.05 * mean.mean())).any()


@pytest.mark.parametrize("folded", [False, True])
def test_texels_beside_another_chart_are_not_compared(folded):
    # Two squares of two triangles each, which touch in the map: apart in space, or the sides of a box.  The whole image shows a surface.
    corners = np.array([(0, 0), (8, 0), (8, 12), (0, 12)], np.float32)
    uv = np.concatenate([(corners + np.array([x, 0]))[[[0, 1, 2], [0, 2, 3]]] for x in (0, 8)])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    normals = np.zeros((4, 3, 3), np.float32)
    normals[..., 2] = 1
    if folded:
        triangles[2:] = [[1, 4, 5], [1, 5, 2]]
        normals[2:] = 1, 0, 0
    chart = chart_image(
        SimpleNamespace(triangles=triangles, corner_normals=normals), Charts(np.arange(4, dtype=np.int32), uv.astype(np.float32)), (16, 12)
    )
    assert (chart[:, :8] == chart[0, 0]).all() and (chart[:, 8:] == chart[0, 8]).all() and chart[0, 0] != chart[0, 8]
    compared = comparable(np.full((12, 16), LIT), chart)
    assert compared[1:-1, 1:7].all() and compared[1:-1, 9:15].all() and not compared[:, 7:9].any()


@pytest.mark.slow
def test_bench_has_rows_for_time_error_seams_and_black_texels():
    rows = lightmap_rows([("box", "cornell", None)], size=48, samples=4, reference_samples=16, repeats=1, round_trip=None)
    cases = " ".join(row["case"] for row in rows)
    assert all(word in cases for word in ("seconds", "relMSE", "bias", "black"))
    assert all(np.isfinite(row["value"]) and row["suite"] == "lightmaps" for row in rows)


@pytest.mark.slow
def test_the_exported_scene_looks_as_computed():
    row = round_trip_row("cornell", (64, 64), 128.0, RenderSettings(seed=2), detail="low")
    assert abs(row["value"]) < 0.02
