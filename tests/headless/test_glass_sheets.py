"""Glass as the surface of a solid, against Cycles: light that begins within it meets its back first, and may be reflected totally.

Such are sheets of one plane, seen from their back, and what lies inside of closed glass.
"""

import hashlib
import math
from pathlib import Path

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.cache import cached_halves

from .test_direct_light import lamp, look, material, quad
from .test_glass import shader, slab

SEEDS = 3


def sky(scene, strength=1.0):
    world = scene.world = bpy.data.worlds.new("World")
    if world.node_tree is None:  # Blender 4.5
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (strength, strength, strength, 1)


def roof(scene, facing, surface, mirrored=False):
    """A plane over the booth whose normal points up (1) or down (-1)."""
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    quad(scene, corners if facing > 0 else corners[::-1], surface, seen=False)
    made = scene.collection.objects[-1]
    made.location = (0, 0, 1)
    if mirrored:
        made.scale = (1, -1, 1)


GLASS = {"Transmission_Weight": 1.0, "Roughness": 0.0, "IOR": 1.5, "Base_Color": (1, 1, 1, 1)}
ROOFS = {
    "up": lambda scene: roof(scene, 1, material("Glass", **GLASS)),
    "down": lambda scene: roof(scene, -1, material("Glass", **GLASS)),
    "mirrored": lambda scene: roof(scene, 1, material("Glass", **GLASS), True),
    "rough": lambda scene: roof(scene, 1, material("Glass", **GLASS | {"Roughness": 0.4})),
    "node": lambda scene: roof(scene, 1, shader("Glass", "ShaderNodeBsdfGlass", Color=(1, 1, 1, 1), Roughness=0.0, IOR=1.33)),
    "refraction": lambda scene: roof(scene, 1, shader("Glass", "ShaderNodeBsdfRefraction", Color=(1, 1, 1, 1), Roughness=0.0, IOR=1.5)),
    "halves": lambda scene: (roof(scene, 1, material("Glass", **GLASS)), roof(scene, -1, material("Glass", **GLASS))),
    "pane": lambda scene: slab(scene, -1.01, 1.01, -1.01, 1.01, 1.0, 1.02, material("Glass", **GLASS)),
    "inside": lambda scene: slab(scene, -0.99, 0.99, -0.99, 0.99, -0.5, 0.999, material("Glass", **GLASS)),
}


def open_box(z=0.0):
    """An empty scene but for a dark floor at height z in a black box that is open above."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    put_box(scene, z)
    return scene


def put_box(scene, z=0.0):
    floor = material("Floor", Base_Color=(0.2, 0.2, 0.2, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-0.8, -0.8, z), (0.8, -0.8, z), (0.8, 0.8, z), (-0.8, 0.8, z)], floor)
    black = material("Black", Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0)
    for x in (-1, 1):
        quad(scene, [(x, -1, -1), (x, 1, -1), (x, 1, 1), (x, -1, 1)], black)
        quad(scene, [(-1, x, -1), (1, x, -1), (1, x, 1), (-1, x, 1)], black)
    quad(scene, [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)], black)


class Row:
    """Booths side by side under the sky, a dark floor in a black box that is open but for a roof in each, seen from above.

    roofs: by name, what puts one over the origin.  inside: name of the one whose floor is close below the top of the solid that it lies in.
    """

    def __init__(self, roofs, inside=None):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = self.scene = bpy.context.scene
        self.names = list(roofs)
        for k, (over, put) in enumerate(roofs.items()):
            others = len(scene.collection.objects)
            put_box(scene, 0.97 if over == inside else 0.0)
            put(scene)
            scene.collection.objects[-1].visible_camera = False
            if over == "halves":
                scene.collection.objects[-1].location.z = 0.99
            for made in scene.collection.objects[others:]:
                made.location.x += 2.2 * k
        sky(scene)
        look(scene, (1.1 * len(roofs) - 1.1, 0, 20), (0, 0, 0), type="ORTHO", ortho_scale=2.2 * len(roofs))
        self.size = (22 * len(roofs), 16)

    def floor(self, layer, over):
        """The part of a picture that shows the floor of a booth, 16 x 16 pixels."""
        begin = 22 * self.names.index(over) + 3
        return layer[:, begin : begin + 16]


@pytest.fixture(scope="module")
def row():
    """(row, halves of the reference, our scene): what far sides of a solid reflect is not modelled, so "inside" is below its top."""
    built = Row(ROOFS, inside="inside")
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "row": built.names}
    return (
        built,
        cached_halves(built.scene, identity, size=built.size, spp=512, bounces=4, seed=1),
        extract_scene(built.scene, size=built.size),
    )


@pytest.fixture(scope="module")
def pictures(row):
    """Of each method, ours of some seeds."""
    return {
        method: [render(row[2], RenderSettings(seed=seed, denoise=False, method=method, direct_samples=32)).layers for seed in range(SEEDS)]
        for method in ("importance-sampling", "instant-radiosity")
    }


@pytest.mark.parametrize(
    ("over", "method"),
    [*((over, "importance-sampling") for over in ROOFS), *((over, "instant-radiosity") for over in ("down", "rough", "pane", "inside"))],
)
def test_light_through_a_sheet_is_as_cycles(row, pictures, over, method):
    built, halves, _ = row
    expected, mine = (
        [built.floor(layers["DiffuseIndirect"], over).mean(dtype=float) for layers in some] for some in (halves, pictures[method])
    )
    noise = abs(expected[0] - expected[1]) / 2 + np.std(mine, ddof=1) / math.sqrt(SEEDS)
    assert abs(np.mean(mine) - np.mean(expected)) <= 0.05 * np.mean(expected) + 3 * noise


@pytest.mark.parametrize("over", ["up", "down", "pane"])
@pytest.mark.parametrize("aside", [0.0, 3.0], ids=["over", "aside"])
def test_lamps_light_through_a_sheet_is_as_cycles(over, aside):
    """A lamp sends the square of the index as much out of glass, and that part of it into glass; past the critical angle nothing leaves."""
    scene = open_box(0.0)
    ROOFS[over](scene)
    lamp(scene, "AREA", (aside, 0.0, 4.0), (0.0, math.atan2(aside, 4.0), 0.0), size=0.5)
    for ob in list(scene.collection.objects)[-2:]:
        ob.visible_camera = False
    look(scene, (0, 0, 0.9), (0, 0, 0), type="ORTHO", ortho_scale=1.6)
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "over": over, "aside": aside}
    halves = cached_halves(scene, identity, size=(16, 16), spp=2048, bounces=4, seed=1)
    arrays = extract_scene(scene, size=(16, 16))
    ours = [render(arrays, RenderSettings(seed=seed, denoise=False)).layers for seed in range(SEEDS)]
    expected, mine = ([layers["DiffuseIndirect"].mean(dtype=float) for layers in some] for some in (halves, ours))
    noise = abs(expected[0] - expected[1]) / 2 + np.std(mine, ddof=1) / math.sqrt(SEEDS)
    assert abs(np.mean(mine) - np.mean(expected)) <= 0.05 * np.mean(expected) + 3 * noise


def screens(facing, **inputs):
    """A screen of one plane, seen at 60 degrees, between a green sign behind it and a red one that it mirrors; the sky is blue."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    corners = [(-1, 0, -0.3), (1, 0, -0.3), (1, 0, 0.3), (-1, 0, 0.3)]
    quad(scene, corners if facing == "front" else corners[::-1], material("Glass", **GLASS | inputs))
    for y, color in ((-1, (1, 0.1, 0.1, 1)), (1, (0.1, 1, 0.1, 1))):
        quad(scene, [(0, y, -3), (9, y, -3), (9, y, 3), (0, y, 3)], shader("Sign", "ShaderNodeEmission", Color=color))
    for sign in list(scene.collection.objects)[-2:]:
        sign.visible_diffuse = False
    angle = math.radians(60)
    look(scene, (-3 * math.sin(angle), -3 * math.cos(angle), 0), (math.pi / 2, 0, -angle), type="ORTHO", ortho_scale=0.4)
    return scene


@pytest.mark.parametrize(
    ("facing", "inputs"),
    [
        ("front", {}),
        ("back", {}),
        ("back", {"Alpha": 0.5}),
        pytest.param("back", {"Thin_Wall": True}, marks=pytest.mark.skipif(bpy.app.version < (5, 2), reason="Blender 5.2 has thin walls")),
    ],
    ids=["front", "back", "half", "thin"],
)
def test_the_back_of_a_sheet_is_a_mirror_beyond_the_critical_angle(facing, inputs):
    scene = screens(facing, **inputs)
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "facing": facing, "inputs": inputs}
    halves = cached_halves(scene, identity, size=(16, 8), spp=64, bounces=4, seed=1)
    layers = render(extract_scene(scene, size=(16, 8)), RenderSettings(denoise=False, pixel_samples=32)).layers
    expected = np.mean([half["Combined"].mean((0, 1), dtype=float) for half in halves], axis=0)
    got = layers["Combined"].mean((0, 1), dtype=float)
    np.testing.assert_allclose(got, expected, atol=0.03)


def test_gather_rays_know_what_shines_behind_a_pane():
    """A large shining ceiling behind a closed pane lights a floor alike, whether gather rays count for it (importance sampling) or not."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    quad(scene, [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], material("White", Base_Color=(0.5, 0.5, 0.5, 1), Specular_IOR_Level=0.0))
    slab(scene, -4, 4, -4, 4, 0.5, 0.52, material("Glass", **GLASS))
    quad(scene, [(-2, -2, 1), (2, -2, 1), (2, 2, 1), (-2, 2, 1)], shader("Shining", "ShaderNodeEmission", Strength=1.0), seen=False)
    scene.collection.objects[-2].visible_camera = False
    look(scene, (0, 0, 6), (0, 0, 0), type="ORTHO", ortho_scale=1.8)
    extracted = extract_scene(scene, size=(16, 16))
    gathered, aimed = (
        np.mean(render(extracted, RenderSettings(method=method, bounces=1, denoise=False)).layers["DiffuseIndirect"])
        for method in ("importance-sampling", "instant-radiosity")
    )
    assert gathered == pytest.approx(aimed, rel=0.03)


def standing(thickness):
    """A pane that stands on a floor under the sky, seen from its front; a sheet where it has no thickness."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    glass = material("Glass", **GLASS)
    quad(scene, [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], material("Grey", Base_Color=(0.7, 0.7, 0.7, 1), Specular_IOR_Level=0.0))
    if thickness:
        slab(scene, -1, 1, 0.5, 0.5 + thickness, 0.001, 1, glass)
    else:
        quad(scene, [(-1, 0.5, 0.001), (1, 0.5, 0.001), (1, 0.5, 1), (-1, 0.5, 1)], glass)
    sky(scene)
    look(scene, (0, -2.5, 2.2), (math.radians(48.7), 0, 0), lens=35)
    return scene


def window_and_mirror():
    """The dark floor under a sheet of glass, and a mirror beside it that shows the sky to it."""
    scene = open_box()
    roof(scene, 1, material("Glass", **GLASS))
    scene.collection.objects[-1].visible_camera = False
    quad(
        scene, [(-0.95, -0.9, 0), (-0.95, 0.9, 0), (-0.95, 0.9, 0.95), (-0.95, -0.9, 0.95)], material("Mirror", Metallic=1.0, Roughness=0.0)
    )
    sky(scene)
    look(scene, (0, 0, 20), (0, 0, 0), type="ORTHO", ortho_scale=1.6)
    return scene


LOBES = {"sheet": lambda: standing(0), "pane": lambda: standing(0.02), "mirror": window_and_mirror}


@pytest.mark.parametrize("place", LOBES)
def test_photons_by_lobes_meet_glass_as_in_cycles(place):
    """What glass reflects on either of its sides, and mirrors of what comes through it, reaches the floor, and what lies behind the glass does not have it, too."""
    scene, seeds = LOBES[place](), 4
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "place": place}
    halves = cached_halves(scene, identity, size=(32, 18), spp=512, bounces=4, seed=1)
    arrays = extract_scene(scene, size=(32, 18))
    ours = [render(arrays, RenderSettings(seed=seed, denoise=False)).layers for seed in range(seeds)]
    for layer in ("DiffuseIndirect", "GlossyIndirect"):
        expected, mine = ([layers[layer].mean(dtype=float) for layers in some] for some in (halves, ours))
        noise = abs(expected[0] - expected[1]) / 2 + np.std(mine, ddof=1) / math.sqrt(seeds)
        assert abs(np.mean(mine) - np.mean(expected)) <= 0.03 * np.mean(expected) + 3 * noise


def before_a_window(shining):
    """A rough, shiny floor before a black wall with a window of one plane, behind which something shines."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    quad(scene, [(-4, -6, 0), (4, -6, 0), (4, 0, 0), (-4, 0, 0)], material("Floor", Base_Color=(0.1, 0.1, 0.1, 1), Roughness=0.7))
    black = material("Black", Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0)
    for left, right, low, high in ((-4, -1, 0, 3), (1, 4, 0, 3), (-1, 1, 0, 0.3), (-1, 1, 1.5, 3)):
        quad(scene, [(left, 0, low), (right, 0, low), (right, 0, high), (left, 0, high)], black)
    quad(scene, [(-1, 0, 0.3), (1, 0, 0.3), (1, 0, 1.5), (-1, 0, 1.5)], material("Glass", **GLASS))
    if shining == "lamp":
        lamp(scene, "AREA", (0, 1.5, 0.9), (math.pi / 2, 0, math.pi), size=0.4)
    elif shining == "sun":
        lamp(scene, "SUN", (0, 0, 0), (math.radians(60), 0, math.pi), angle=math.radians(14))
    else:
        quad(
            scene, [(-0.2, 1.5, 0.7), (0.2, 1.5, 0.7), (0.2, 1.5, 1.1), (-0.2, 1.5, 1.1)],
            shader("Shining", "ShaderNodeEmission", Strength=20.0),
        )  # fmt: skip
    look(scene, (0, -5, 2.5), (math.atan2(3.5, 2.5), 0, 0), type="ORTHO", ortho_scale=2.4)
    return scene


@pytest.mark.parametrize("shining", ["lamp", "sun", "mesh"])
def test_wide_lobes_show_what_shines_beyond_a_sheet_where_it_bends_it(shining):
    """Straight on it would be elsewhere: along such a floor a lamp was .4 to 2.5 times as bright as in Cycles, the sun up to five times."""
    scene, size = before_a_window(shining), (24, 15)
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "shining": shining}
    halves = cached_halves(scene, identity, size=size, spp=1024, bounces=4, seed=1)
    arrays = extract_scene(scene, size=size)
    ours = [render(arrays, RenderSettings(seed=seed, denoise=False)).layers for seed in range(SEEDS)]
    for rows in (slice(0, 5), slice(5, 10), slice(10, 15)):
        expected, mine = ([layers["GlossyIndirect"][rows].mean(dtype=float) for layers in some] for some in (halves, ours))
        noise = abs(expected[0] - expected[1]) / 2 + np.std(mine, ddof=1) / math.sqrt(SEEDS)
        least = 0.01 * np.mean(halves[0]["GlossyIndirect"])  # beside a sharp patch of sun, of which disks of photons reach out
        assert abs(np.mean(mine) - np.mean(expected)) <= 0.06 * np.mean(expected) + 3 * noise + least


def test_lamps_that_glass_does_not_show_shine_through_none():
    """As in Cycles, where light comes through glass by rays that see it, the floor is dark then; and what reflections do not show of a lamp they show beyond glass."""
    lit = {}
    for hidden in ("visible_transmission", "visible_glossy"):
        scene = before_a_window("lamp")
        setattr(next(ob for ob in scene.collection.objects if ob.type == "LIGHT"), hidden, False)
        layers = render(extract_scene(scene, size=(24, 15)), RenderSettings(denoise=False)).layers
        lit[hidden] = layers["DiffuseIndirect"].mean(dtype=float), layers["GlossyIndirect"].mean(dtype=float)
    assert lit["visible_transmission"] == pytest.approx((0, 0), abs=1e-6)
    assert min(lit["visible_glossy"]) > 1e-4
