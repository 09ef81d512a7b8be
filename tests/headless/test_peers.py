"""Other renderers show the neutral scene as we do: lamps, textures, cut-outs, camera and world; and the suite says what it leaves out."""

import importlib.util
import json
from contextlib import closing
from dataclasses import replace
from functools import partial

import bpy
import numpy as np
import pytest

from lumigate.core.errors import SceneError
from lumigate.core.scene import AREA, POINT, RECTANGLE, SPOT, SUN, Camera, Lamps
from lumigate.core.settings import RenderSettings
from lumigate.headless import contestants
from lumigate.headless.bench_suites import STEPS
from lumigate.headless.cli import main
from lumigate.headless.curves_bench import OURS, Point, Time
from lumigate.headless.peers import blender, mitsuba, suite
from lumigate.headless.peers.check import same_light
from lumigate.headless.peers.neutral import Neutral, Sheet, Surface, back_of, neutral_scene
from lumigate.headless.peers.worker import Worker
from lumigate.headless.sources import extract, open_source

SIZE = (64, 36)
ALBEDO = np.array([0.5, 0.3, 0.1], np.float32)
DARK = np.zeros(3, np.float32)


def quad(corners, surface):
    """Two triangles, uv (0, 0) at the first corner and (1, 1) at the third."""
    corners, uv = np.asarray(corners, np.float32), np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)
    order = [[0, 1, 2], [0, 2, 3]]
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    normals = np.broadcast_to(normal / np.linalg.norm(normal), (2, 3, 3)).astype(np.float32)
    return Sheet(surface, corners[order], normals, uv[order])


def even(name, albedo=ALBEDO, opacity=1.0, emission=DARK):
    return Surface(name, albedo, np.float32(opacity), np.asarray(emission, np.float32))


def lamp(kind, position, emission, angle=0.0, axes=None, size=(0.0, 0.0)):
    one = Lamps.empty()
    rows = {
        "kind": kind, "position": position, "emission": emission, "angle": angle, "axes": np.eye(3) if axes is None else axes, "size": size,
        "shape": RECTANGLE, "visibility": 31, "cast_shadow": 1, "radius": 0.0, "soft_falloff": 0, "blend": 0.0,
    }  # fmt: skip
    arrays = {name: np.array([value], getattr(one, name).dtype) for name, value in rows.items()}
    return Lamps(**arrays, names=[f"lamp {kind}"], groups=[""])


def above(height=6.0, shift=(0.0, 0.0)):
    """A camera that looks down on the origin and sees 8 m by 4.5 m of the ground, moved by a lens shift in m at distance 1."""
    matrix = np.eye(4)
    matrix[2, 3] = height
    x, y = 4 / height, 2.25 / height
    window = (shift[0] - x, shift[0] + x, shift[1] - y, shift[1] + y)
    return Camera(matrix, False, window, *SIZE, (0, 0, *SIZE), 0.1, 100.0, "Camera")


@pytest.fixture(scope="module")
def scene():
    """Every kind of lamp, each over a place of its own; a texture without symmetry, a cut-out, an emitter, a world and a lens shift."""
    random = np.random.default_rng(1)
    image = np.round(random.uniform(0.1, 0.9, (4, 8, 3)) * 255).astype(np.float32) / 255
    holes = np.zeros((2, 4), np.float32)
    holes[0, 0] = holes[1, 2] = 1
    slanted = np.array([(0, 1, 0), (-0.8, 0, 0.6), (0.6, 0, 0.8)])  # shines down, and to the left
    lamps = [
        lamp(POINT, (-2, -1, 0.8), (2, 1, 3)),
        lamp(SPOT, (-2, 1.2, 1.5), (9, 9, 3), angle=0.9, axes=slanted),
        lamp(SUN, (0, 0, 0), (0.4, 0.3, 0.2), axes=slanted),
        lamp(AREA, (4.7, 1, 0.5), (90, 50, 10), angle=np.pi, axes=[(0, 1, 0), (0, 0, 1), (1, 0, 0)], size=(0.4, 0.2)),  # to the left
    ]
    joined = lamps[0]
    for one in lamps[1:]:
        joined = joined.joined(one)
    sheets = [
        quad([(-6, -4, 0), (6, -4, 0), (6, 4, 0), (-6, 4, 0)], Surface("floor", image, np.float32(1), DARK)),
        quad([(1.6, -1.8, 0.5), (3.2, -1.8, 0.5), (3.2, -0.6, 0.5), (1.6, -0.6, 0.5)], Surface("leaf", ALBEDO, holes, DARK)),
        quad([(-0.2, -1.5, 0.3), (-0.2, -1.2, 0.3), (-0.2, -1.2, 0.6), (-0.2, -1.5, 0.6)], even("glow", emission=(3, 2, 1))),
    ]
    return Neutral(sheets, joined, np.array([0.05, 0.1, 0.2], np.float32), above(shift=(0.06, -0.04)))


@pytest.fixture(scope="module")
def ours(scene):
    return contestants.ours(blender.build(scene), SIZE, RenderSettings(denoise=False, pixel_samples=256)).layers


def call(module, neutral, function, *arguments):
    """Of Mitsuba here, by the variant that needs no LLVM; of LuxCore in a process of its own."""
    if module == mitsuba.NAME:
        pytest.importorskip("mitsuba")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(mitsuba, "VARIANT", "scalar_rgb")
            mitsuba.start.cache_clear()
            return getattr(mitsuba, function)(neutral, *arguments)
    if importlib.util.find_spec("pyluxcore") is None:  # which may not be imported where Mitsuba is
        pytest.skip("pyluxcore is not installed")
    with closing(Worker(module, neutral)) as worker:
        return worker.call(function, *arguments)


PEERS = pytest.mark.parametrize("module, way", [("mitsuba", ("volpath",)), ("luxcore", ())], ids=["mitsuba", "luxcore"])


@PEERS
def test_each_lamp_lights_the_ground_as_ours_does(scene, ours, module, way):
    shown = ~ours["Emission"].any(2)
    first, second = (call(module, scene, "direct", *way, 256, seed) for seed in (1, 2))
    check = same_light((ours["Direct"],) * 2, (first, second), shown)
    assert abs(check.mean - 1) < 0.01 and check.worst < 0.08, check
    for x, y in ((-2, -1), (-3.2, 1.2), (3.5, 1), (-0.6, -1.35)):  # beneath each lamp
        i = int((x / 8 + 0.5 - 0.06 * 6 / 8) * SIZE[0])
        j = int((0.5 - y / 4.5 - 0.04 * 6 / 4.5) * SIZE[1])
        place = np.s_[j - 2 : j + 3, i - 2 : i + 3]
        assert first[place].mean((0, 1)) == pytest.approx(ours["Direct"][place].mean((0, 1)), rel=0.05)


@PEERS
def test_edges_textures_and_gaps_are_in_the_same_pixels(scene, ours, module, way):
    arguments = (*way, 64, 0, 3) if way else (False, 64, 0, 3)
    layers = call(module, scene, "render", *arguments)[0]
    difference = np.abs(layers["Albedo"] - ours["Albedo"])
    if module == mitsuba.NAME:
        difference = difference[: SIZE[1] // 2]  # above the leaf: it tells of a gap the leaf's own colour
    assert difference.mean() < 0.01 and np.quantile(difference, 0.99) < 0.1


@PEERS
def test_a_sky_lies_where_it_does_in_blender(module, way):
    azimuth = np.pi - 2 * np.pi * (np.arange(64) + 0.5) / 64
    polar = np.pi * (np.arange(32) + 0.5) / 32
    directions = np.stack(
        [np.sin(polar)[:, None] * np.cos(azimuth), np.sin(polar)[:, None] * np.sin(azimuth), np.cos(polar)[:, None] + 0 * azimuth], 2
    )
    world = (1 + 0.9 * directions).astype(np.float32)
    camera = above()
    camera.matrix = np.eye(4)
    camera.matrix[:3, :3] = np.stack([(-1, 0, 0), (0, 0, 1), (0, 1, 0)], 1)  # looks along -y, z upwards
    floor = quad([(-1, 5, -9), (1, 5, -9), (1, 6, -9), (-1, 6, -9)], even("floor"))
    neutral = Neutral([floor], Lamps.empty(), world, camera)
    arguments = ("path", 16, 1, 0) if way else (False, 16, 1, 0)
    layers = call(module, neutral, "render", *arguments)[0]
    ours = contestants.ours(blender.build(neutral), SIZE, RenderSettings(denoise=False, pixel_samples=16)).layers
    assert np.abs(layers["Combined"] - ours["Combined"]).max() < 0.05
    assert np.ptp(ours["Combined"], (0, 1)).min() > 0.1  # in all axes


def test_ground_beneath_a_lamp_has_the_radiance_of_the_formula():
    """Point: rho / pi I h / (h^2 + r^2)^(3/2); sun: rho / pi E cos."""
    ground = quad([(-6, -4, 0), (6, -4, 0), (6, 4, 0), (-6, 4, 0)], even("ground"))
    x = (np.arange(SIZE[0]) + 0.5) / SIZE[0] * 8 - 4
    y = 2.25 - (np.arange(SIZE[1]) + 0.5) / SIZE[1] * 4.5
    slanted = np.array([(0, 1, 0), (-0.8, 0, 0.6), (0.6, 0, 0.8)])
    for one, irradiance in (
        (lamp(POINT, (0.5, 0.25, 1.5), (6, 6, 6)), 6 * 1.5 / ((x - 0.5) ** 2 + (y[:, None] - 0.25) ** 2 + 1.5**2) ** 1.5),
        (lamp(SUN, (0, 0, 0), (2, 2, 2), axes=slanted), np.full((SIZE[1], SIZE[0]), 2 * 0.8)),
    ):
        light = call("mitsuba", Neutral([ground], one, DARK, above()), "direct", "path", 64, 0)
        assert light == pytest.approx(irradiance[..., None] * ALBEDO / np.pi, rel=0.04)


def test_blender_holds_the_same_scene(scene):
    found = extract(blender.build(scene), camera=None, size=SIZE, frame=None)
    lamps, wanted = found.lamps, scene.lamps
    order = [lamps.names.index(name) for name in wanted.names]
    assert lamps.emission[order] == pytest.approx(wanted.emission, rel=1e-5)
    assert lamps.position[order] + found.origin == pytest.approx(wanted.position, abs=1e-5)
    assert lamps.axes[order] == pytest.approx(wanted.axes, abs=1e-5) and lamps.angle[order] == pytest.approx(wanted.angle, abs=1e-5)
    assert found.camera.window == pytest.approx(scene.camera.window, abs=1e-6)
    assert found.world.radiance[0, 0] == pytest.approx(scene.world, rel=1e-6)
    again = neutral_scene(found)
    names = [sheet.surface.name for sheet in again.sheets]
    for sheet in scene.sheets:
        surface = again.sheets[names.index(sheet.surface.name)].surface
        assert surface.is_opaque == sheet.surface.is_opaque and surface.emission == pytest.approx(sheet.surface.emission)
        assert surface.albedo == pytest.approx(sheet.surface.albedo, abs=0.006)
        assert surface.opacity == pytest.approx(sheet.surface.opacity, abs=0.006)


def test_materials_keep_their_colours():
    arrays = extract(open_source("cornell"), camera=None, size=SIZE, frame=None)
    colours = {sheet.surface.name: sheet.surface.albedo for sheet in neutral_scene(arrays).sheets}
    assert colours["Red"] == pytest.approx((0.63, 0.065, 0.05), abs=1e-4)


def test_the_back_of_an_emitter_faces_away(scene):
    glow = scene.sheets[2]
    back = back_of(glow, scene.extent)
    edges = [sheet.positions[:, 1:] - sheet.positions[:, :1] for sheet in (glow, back)]
    normals = [np.cross(e[:, 0], e[:, 1]) for e in edges]
    assert (np.einsum("tc,tc->t", *normals) < 0).all() and np.abs(back.positions[:, ::-1] - glow.positions).max() < 1e-3


@pytest.fixture
def cornell():
    return extract(open_source("cornell"), camera=None, size=SIZE, frame=None)


def test_what_no_peer_can_do_is_named(cornell):
    def refuses(match, **changes):
        with pytest.raises(SceneError, match=match):
            neutral_scene(replace(cornell, **changes))

    refuses("camera 'Camera' is orthographic", camera=replace(cornell.camera, orthographic=True))
    refuses("pixels of camera 'Camera'", camera=replace(cornell.camera, window=(-1.0, 1.0, -1.0, 1.0)))
    refuses("object 'Room' is hidden", geometry=replace(cornell.geometry, object_visibility=np.array([30, 31, 31], np.uint32)))
    refuses("lamp 'Lamp' casts no shadow", lamps=replace(cornell.lamps, cast_shadow=np.zeros(1, np.uint8)))
    refuses("lamp 'Lamp' has a falloff", lamps=replace(cornell.lamps, falloff=np.ones((1, 2), np.float32)))
    refuses("lamp 'Lamp' has nodes", lamps=replace(cornell.lamps, program=np.zeros(1, np.int32)))
    refuses("no light", lamps=Lamps.empty())


def test_another_light_is_noticed():
    random = np.random.default_rng(0)
    light, shown = random.uniform(0.5, 1.5, (36, 64, 3)), np.ones((36, 64), bool)
    noisy = [light * random.normal(1, 0.02, light.shape) for _ in range(2)]
    assert same_light((light, light), noisy, shown).holds
    assert not same_light((light, light), [1.02 * picture for picture in noisy], shown).holds
    assert not same_light((light, light), [np.roll(picture, 5, 1) for picture in noisy], shown).holds
    patch = np.ones_like(light)
    patch[:5, :5] = 0.8
    assert not same_light((light, light), [patch * picture for picture in noisy], shown).holds
    shown[:5, :5] = False
    assert same_light((light, light), [patch * picture for picture in noisy], shown).holds


def point(method, amount, seconds, relmse):
    return Point(method, str(amount), amount, [seconds], {"Light": [{"relmse": relmse}]})


def test_times_are_those_of_the_best_way_of_each_renderer():
    ours = [point(OURS.method, 1, 1.0, 0.08), point(OURS.method, 2, 2.0, 0.005)]
    cycles = [point("cycles+oidn", 16, 4.0, 0.04), point("guided cycles+oidn", 16, 5.0, 0.01)]
    cycles += [point(method, 64, 20.0, 0.005) for method in ("cycles+oidn", "guided cycles+oidn")]
    peers = [
        point("mitsuba", 16, 3.0, 0.5),
        point("mitsuba+oidn", 16, 5.0, 0.3),
        point("luxcore", 16, 3.0, 0.5),
        point("luxcore", 64, 30.0, 0.02),
    ]
    rows = {(row["renderer"], row["relmse"]): row for row in suite.time_rows("room", "Light", [*ours, *cycles, *peers], 0.003)}
    assert rows["luxcore", 0.02]["peer_value"] == pytest.approx(30) and "ratio_bound" not in rows["luxcore", 0.02]
    assert "noise of the reference: 3.0e-03" in rows["luxcore", 0.02]["case"]
    row = rows["mitsuba", 0.05]
    assert "noise" not in row["case"]
    assert row["peer_bound"] == row["ratio_bound"] == "more than" and row["peer_value"] == 5.0  # the one that comes nearest
    assert rows["cycles", 0.02]["peer_bound"] == "less than" and rows["cycles", 0.02]["method"] == "guided cycles+oidn"
    assert rows["cycles", 0.01]["value"] == pytest.approx(Time(2.0).seconds, rel=0.3)  # at Cycles' own error


@pytest.mark.slow
def test_the_suite_says_what_is_not_there_and_goes_on(tmp_path, monkeypatch, capsys):
    scene = open_source("cornell")
    scene.camera.data.type = "ORTHO"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "flat.blend"))
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "nowhere.so"))
    monkeypatch.setitem(STEPS, "peers", partial(suite.peers_steps, qualities=(0.25, 1.0)))
    options = [
        "--scenes",
        str(tmp_path / "flat.blend"),
        "cornell",
        "--size",
        "32x18",
        "--spp",
        "2",
        "--reference-samples",
        "16",
        "--repeats",
        "1",
    ]
    assert main(["bench", "peers", "-o", str(tmp_path / "bench"), *options]) == 0
    rows = json.loads((tmp_path / "bench" / "results.json").read_text())["rows"]
    said = [row["case"] for row in rows if row["suite"] == "peers-check"]
    assert any("refused: camera" in line for line in said) and any("Mitsuba" in line for line in said)
    methods = {row["method"] for row in rows if row["suite"] == "peers"}
    assert {OURS.method, "cycles", "guided cycles+oidn"} <= methods and not any("mitsuba" in method for method in methods)
    assert all((tmp_path / "bench" / name).stat().st_size > 1000 for name in ("peers-Light.png", "beside-peers-cornell.png", "report.md"))
    capsys.readouterr()

    def never(*arguments):
        raise AssertionError("what was measured is kept")

    monkeypatch.setattr(suite, "_scene_rows", never)
    assert main(["bench", "peers", "-o", str(tmp_path / "bench"), *options]) == 0
    assert capsys.readouterr().err.count("kept from an earlier run") == 2


def test_scenes_that_are_not_there_are_named(tmp_path):
    with pytest.raises(SceneError, match="nowhere"):
        suite.peers_steps(tmp_path, scenes=("cornell", "nowhere"))
