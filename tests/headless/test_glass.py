"""Glass against Cycles: what is seen through it is transmitted light, what it reflects is glossy, what lamps send through it is indirect."""

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

SIZE = (48, 27)
SPP = 256
SEEDS = 4
# Columns of the picture behind each thing, without those at its edges.
BEHIND = {"slab": slice(1, 11), "film": slice(13, 23), "veil": slice(25, 35), "nothing": slice(37, 47)}


def shader(name, node_type, **inputs):
    """A material of one shader node."""
    made = material(name)
    tree = made.node_tree
    node = tree.nodes.new(node_type)
    for key, value in inputs.items():
        node.inputs[key].default_value = value
    tree.links.new(node.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    return made


def slab(scene, x0, x1, y0, y1, z0, z1, surface):
    """A closed box, seen along y."""
    corners = [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)]
    mesh = bpy.data.meshes.new("Slab")
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    mesh.materials.append(surface)
    scene.collection.objects.link(bpy.data.objects.new("Slab", mesh))


def showcase():
    """A lit corner with signs, seen through a slab of glass, through a film that refracts nothing, through a veil, and free.

    The world shines in above.  A bright sign behind the camera shows in the slab.  No light passes glass to reach a surface:
    the world lights nothing, the bright sign is far away, and panes hide nothing from walls.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.7, 0.6, 0.5, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-4, 0, 0), (4, 0, 0), (4, 3, 0), (-4, 3, 0)], white)
    quad(scene, [(-4, 3, 0), (4, 3, 0), (4, 3, 2), (-4, 3, 2)], white)
    for x in (-2.25, -0.75, 0.75, 2.25):
        sign = shader("Sign", "ShaderNodeEmission", Strength=0.5)
        quad(scene, [(x - 0.2, 2.99, 0.6), (x + 0.2, 2.99, 0.6), (x + 0.2, 2.99, 0.9), (x - 0.2, 2.99, 0.9)], sign)
    bright = shader("Bright sign", "ShaderNodeEmission", Strength=4.0)
    quad(scene, [(-4, -200, -5), (4, -200, -5), (4, -200, 1.2), (-4, -200, 1.2)], bright)
    scene.collection.objects[-1].visible_diffuse = False
    lamp(scene, "AREA", (0, 1.2, 2.2), energy=60.0, size=1.0, seen=False)
    glass = material("Glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.5, Base_Color=(0.81, 1, 0.64, 1))
    slab(scene, -3, -1.5, -0.52, -0.5, -1, 3, glass)
    film = shader("Film", "ShaderNodeBsdfRefraction", Color=(0.5, 0.8, 1, 1), IOR=1.0)
    quad(scene, [(-1.5, -0.5, -1), (0, -0.5, -1), (0, -0.5, 3), (-1.5, -0.5, 3)], film)
    veil = shader("Veil", "ShaderNodeBsdfTransparent", Color=(0.5, 0.8, 1, 1))
    quad(scene, [(0, -0.5, -1), (1.5, -0.5, -1), (1.5, -0.5, 3), (0, -0.5, 3)], veil)
    for pane in scene.collection.objects[-3:]:
        pane.visible_diffuse = False
    world = scene.world = bpy.data.worlds.new("World")
    if world.node_tree is None:  # Blender 4.5
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.1, 0.2, 0.4, 1)
    world.cycles_visibility.diffuse = world.cycles_visibility.glossy = False
    look(scene, (0, -6, 1.0), (math.pi / 2, 0, 0), type="ORTHO", ortho_scale=6.0)
    return scene


@pytest.fixture(scope="module")
def pictures():
    """(halves of the reference, ours of some seeds)."""
    scene = showcase()
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest()}
    halves = cached_halves(scene, identity, size=SIZE, spp=SPP, bounces=4, seed=1)
    arrays = extract_scene(scene, size=SIZE)
    return halves, [render(arrays, RenderSettings(seed=seed, denoise=False)).layers for seed in range(SEEDS)]


@pytest.mark.parametrize("name", ["Direct", "DiffuseIndirect", "GlossyIndirect", "Emission", "Albedo", "Combined"])
@pytest.mark.parametrize("behind", BEHIND)
def test_light_is_booked_as_cycles_books_it(pictures, behind, name):
    halves, ours = ([layers[name][:, BEHIND[behind]].mean((0, 1), dtype=float) for layers in some] for some in pictures)
    expected = np.mean(halves, axis=0)
    noise = np.abs(halves[0] - halves[1]) / 2 + np.std(ours, axis=0, ddof=1) / math.sqrt(SEEDS)
    # What the slab's back reflects leaves by its mean Fresnel term, 5 % less than at this view.
    bound = 0.035 if behind == "slab" else 0.015
    assert (np.abs(np.mean(ours, axis=0) - expected) <= bound * np.abs(expected) + 2 * noise).all()
    assert (noise <= 0.03 * np.abs(expected)).all()


def test_nothing_diffuse_is_seen_through_glass(pictures):
    for layers in (*pictures[0], *pictures[1]):
        for name in ("Albedo", "DiffuseIndirect", "Irradiance", "Emission"):
            for behind in ("slab", "film"):
                assert not layers[name][:, BEHIND[behind]].any()


def test_depth_and_normal_are_the_pane_s(pictures):
    for name in ("Depth", "Normal"):
        for behind in ("slab", "film"):
            expected, ours = (some[0][name][:, BEHIND[behind]] for some in pictures)
            np.testing.assert_allclose(ours, expected, rtol=1e-4, atol=1e-5)


def glass_to_the_view_alone(made):
    """Turns a material of glass into one that shadow and diffuse rays pass as if it were not there: architectural glass."""
    tree = made.node_tree
    end = tree.get_output_node("CYCLES").inputs["Surface"]
    path, rays, mix = (tree.nodes.new(kind) for kind in ("ShaderNodeLightPath", "ShaderNodeMath", "ShaderNodeMixShader"))
    rays.operation = "MAXIMUM"
    for socket, output in zip(rays.inputs, ("Is Shadow Ray", "Is Diffuse Ray")):
        tree.links.new(path.outputs[output], socket)
    tree.links.new(rays.outputs[0], mix.inputs[0])
    tree.links.new(end.links[0].from_socket, mix.inputs[1])
    tree.links.new(tree.nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], end)
    return made


def test_what_architectural_glass_shows_is_booked_as_behind_glass():
    """The world above it and the lit corner: two sides of glass are two bounces, whatever shadow rays find."""
    scene = showcase()
    glass_to_the_view_alone(bpy.data.materials["Glass"])
    # What its back reflects passes its front, which rays drawn from lobes take for transparent, as diffuse rays do: not what is tested here.
    for thing in scene.objects:
        if thing.type == "MESH" and thing.active_material.name == "Bright sign":
            thing.visible_glossy = thing.visible_transmission = False
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "glass": "architectural"}
    halves = cached_halves(scene, identity, size=SIZE, spp=SPP, bounces=4, seed=1)
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(seed=seed, denoise=False)).layers for seed in range(SEEDS)]
    for name in ("Direct", "Emission", "DiffuseIndirect", "GlossyIndirect", "Combined"):
        expected, mine = ([layers[name][:, BEHIND["slab"]].mean((0, 1), dtype=float) for layers in some] for some in (halves, ours))
        noise = np.abs(expected[0] - expected[1]) / 2 + np.std(mine, axis=0, ddof=1) / math.sqrt(SEEDS)
        mine, expected = np.mean(mine, axis=0), np.mean(expected, axis=0)
        # The world's reflection in the slab's back, which has passed its front, is 4 % of what shows the world, and is left out here.
        assert (np.abs(mine - expected) <= 0.08 * expected + 2 * noise + 1e-6).all(), (name, mine, expected)
    assert (expected > 0.01).all()


def test_denoising_keeps_the_books():
    arrays = extract_scene(showcase(), size=SIZE)
    raw, clean = (render(arrays, RenderSettings(denoise=denoise, pixel_samples=8)).layers for denoise in (False, True))
    for behind, columns in BEHIND.items():
        for name in ("DiffuseIndirect", "GlossyIndirect", "Combined"):
            before, after = (layers[name][:, columns].mean((0, 1), dtype=float) for layers in (raw, clean))
            np.testing.assert_allclose(after, before, rtol=0.05, atol=0.005, err_msg=f"{name} {behind}")
    assert not clean["DiffuseIndirect"][:, BEHIND["slab"]].any()


# -- light that passes glass on its way from the lamp --------------------------------------------------------

ROOFS = ("slab", "film", "veil")


def booths(lamps, **floor):
    """Three boxes whose floors are lit through their roofs only: a slab of glass, a film that refracts nothing, a veil.

    lamps: "area", one above each roof, or "world".  floor: inputs of its material.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    floor = material("Floor", **({"Base_Color": (0.7, 0.6, 0.5, 1), "Specular_IOR_Level": 0.0} | floor))
    black = material("Black", Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0)
    glass = material("Glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.5, Base_Color=(0.81, 1, 0.64, 1))
    film = shader("Film", "ShaderNodeBsdfRefraction", Color=(0.5, 0.8, 1, 1), IOR=1.0)
    veil = shader("Veil", "ShaderNodeBsdfTransparent", Color=(0.5, 0.8, 1, 1))
    for k, roof in enumerate(ROOFS):
        a, b = 2.0 * k - 3.0, 2.0 * k - 1.0
        quad(scene, [(a, -1, 0), (b, -1, 0), (b, 1, 0), (a, 1, 0)], floor)
        for x in (a, b):
            quad(scene, [(x, -1, 0), (x, 1, 0), (x, 1, 3), (x, -1, 3)], black)
        for y in (-1, 1):
            quad(scene, [(a, y, 0), (b, y, 0), (b, y, 3), (a, y, 3)], black)
        if roof == "slab":
            slab(scene, a, b, -1, 1, 1.0, 1.02, glass)
        else:
            quad(scene, [(a, -1, 1), (b, -1, 1), (b, 1, 1), (a, 1, 1)], film if roof == "film" else veil)
        scene.collection.objects[-1].visible_camera = False
        if lamps == "area":
            lamp(scene, "AREA", (a + 1, 0, 2), energy=60.0, size=1.0, seen=False)
    if lamps == "world":
        world = scene.world = bpy.data.worlds.new("World")
        if world.node_tree is None:  # Blender 4.5
            world.use_nodes = True
        world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.5, 0.7, 1, 1)
    look(scene, (0, 0, 20), (0, 0, 0), type="ORTHO", ortho_scale=6.0)
    return scene


METAL = {"Metallic": 1.0}


@pytest.mark.parametrize(
    ("indirect", "floor"),
    [("DiffuseIndirect", {}), ("GlossyIndirect", METAL | {"Roughness": 0.15}), ("GlossyIndirect", METAL | {"Roughness": 0.5})],
    ids=["diffuse", "polished", "rough"],
)
@pytest.mark.parametrize("lamps", ["area", "world"])
def test_light_that_passes_glass_is_indirect_light(lamps, indirect, floor):
    scene = booths(lamps, **floor)
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "lamps": lamps, "floor": floor}
    halves = cached_halves(scene, identity, size=(48, 16), spp=512, bounces=4, seed=1)
    arrays = extract_scene(scene, size=(48, 16))
    ours = [render(arrays, RenderSettings(seed=seed, denoise=False, direct_samples=8)).layers for seed in range(SEEDS)]
    for k, roof in enumerate(ROOFS):
        place = np.s_[3:13, 16 * k + 3 : 16 * k + 13]
        # Reflections to and fro within the slab are left out.
        bound = 0.03 if roof == "slab" else 0.02
        for name in ("Direct", indirect):
            expected, mine = ([layers[name][place].mean((0, 1), dtype=float) for layers in some] for some in (halves, ours))
            noise = np.abs(expected[0] - expected[1]) / 2 + np.std(mine, axis=0, ddof=1) / math.sqrt(SEEDS)
            mine, expected = np.mean(mine, axis=0), np.mean(expected, axis=0)
            assert (np.abs(mine - expected) <= bound * expected + 3 * noise + 1e-6).all(), (roof, name)
            assert (expected > 1e-3).all() == ((name == "Direct") == (roof == "veil"))


def test_indirect_light_alone_holds_what_passes_glass():
    arrays = extract_scene(booths("area"), size=(48, 16))
    alone = render(arrays, RenderSettings(denoise=False, layers=("DiffuseIndirect",))).layers["DiffuseIndirect"]
    whole = render(arrays, RenderSettings(denoise=False)).layers["DiffuseIndirect"]
    np.testing.assert_allclose(alone, whole, rtol=1e-5, atol=1e-7)


def test_without_bounces_nothing_passes_glass():
    arrays = extract_scene(booths("area"), size=(48, 16))
    layers = render(arrays, RenderSettings(denoise=False, bounces=0)).layers
    assert layers["Direct"].any()
    assert not layers["DiffuseIndirect"].any()


def lens(outer, inner=None, lamp_height=4):
    """A floor under a lamp with something of glass between: a ball of radius `outer`, hollow where `inner` is given."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    quad(scene, [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], material("Floor", Base_Color=(0.7, 0.6, 0.5, 1), Specular_IOR_Level=0.0))
    glass = material("Glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.5, Base_Color=(1, 1, 1, 1))
    for radius in (outer, inner):
        if radius:
            bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=radius, location=(0, 0, 1))
            ball = bpy.context.object
            ball.visible_camera = False
            ball.visible_diffuse = inner is not None  # a lens throws nothing where shadow rays alone meet it
            ball.data.shade_smooth()
            if radius == inner:
                ball.data.flip_normals()
            ball.data.materials.append(glass)
    lamp(scene, "AREA", (0, 0, lamp_height), energy=60.0, size=0.2, seen=False)
    look(scene, (0, 0, 20), (0, 0, 0), type="ORTHO", ortho_scale=2.0)
    return extract_scene(scene, size=(16, 16))


def floor_light(arrays):
    layers = render(arrays, RenderSettings(denoise=False, method="instant-radiosity", bounces=1, direct_samples=16)).layers
    return layers["Direct"][4:12, 4:12].mean(dtype=float), layers["DiffuseIndirect"][4:12, 4:12].mean(dtype=float)


def test_a_ball_of_glass_casts_a_shadow():
    open_, _ = floor_light(lens(None))
    direct, indirect = floor_light(lens(0.8))
    assert direct == 0
    assert indirect < 0.05 * open_  # along the axis it turns nothing aside


def test_a_bulb_of_glass_lets_light_through():
    """Around the lamp, and between it and the floor; a wall has two sides that pass 92 % of what comes straight."""
    open_, _ = floor_light(lens(None))
    direct, indirect = floor_light(lens(0.8, 0.78))
    assert direct == 0
    assert 0.8 * open_ < indirect < 0.86 * open_
    open_, _ = floor_light(lens(None, lamp_height=1))
    direct, indirect = floor_light(lens(0.8, 0.78, lamp_height=1))
    assert direct == 0
    assert 0.9 * open_ < indirect < 0.93 * open_


# -- bounces of light that passes glass ----------------------------------------------------------------------


def lit_by_a_window(pane):
    """A closed white room, lit by the world through a window in its ceiling that holds a slab of glass, a film that refracts nothing, or a veil."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.75, 0.75, 0.75, 1), Specular_IOR_Level=0.0)
    corners = [(x, y, z) for x in (-2, 2) for y in (-2, 2) for z in (0, 2.6)]
    for face in [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4)]:
        quad(scene, [corners[k] for k in face], white)
    for a, b, c, d in ((-2, 2, -2, -1), (-2, 2, 1, 2), (-2, -1, -1, 1), (1, 2, -1, 1)):
        quad(scene, [(a, c, 2.6), (b, c, 2.6), (b, d, 2.6), (a, d, 2.6)], white)
    if pane == "slab":
        slab(scene, -1, 1, -1, 1, 2.59, 2.61, shader("Glass", "ShaderNodeBsdfGlass", Roughness=0.0, IOR=1.45))
    else:
        kind, inputs = ("Refraction", {"IOR": 1.0}) if pane == "film" else ("Transparent", {})
        quad(scene, [(-1, -1, 2.6), (1, -1, 2.6), (1, 1, 2.6), (-1, 1, 2.6)], shader("Pane", f"ShaderNodeBsdf{kind}", **inputs))
    world = scene.world = bpy.data.worlds.new("World")
    if world.node_tree is None:  # Blender 4.5
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.5, 0.7, 1, 1)
    look(scene, (-1.7, -1.7, 1.3), (math.radians(70), 0, math.radians(-45)), lens=24.0)
    return scene


@pytest.mark.parametrize("bounces", [1, 3])
def test_glass_takes_a_bounce_of_the_light_that_it_lets_in(bounces):
    """A path of Cycles ends at the first surface after its last bounce, be that a window pane."""
    scene = lit_by_a_window("slab")
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "window": bounces}
    halves = cached_halves(scene, identity, size=(32, 18), spp=256, bounces=bounces, seed=1)
    arrays = extract_scene(scene, size=(32, 18))
    ours = [render(arrays, RenderSettings(seed=seed, bounces=bounces)).layers for seed in range(SEEDS)]
    expected, mine = ([layers["DiffuseIndirect"].mean(dtype=float) for layers in some] for some in (halves, ours))
    noise = abs(expected[0] - expected[1]) / 2 + np.std(mine, ddof=1) / math.sqrt(SEEDS)
    assert noise < 0.02 * np.mean(expected)
    assert np.mean(mine) == pytest.approx(np.mean(expected), rel=0.03, abs=2 * noise)  # 16 seeds: -1.5 +- .3 %; a bounce is far more


@pytest.mark.parametrize("method", ["importance-sampling", "instant-radiosity"])
def test_light_through_glass_has_a_bounce_less(method):
    """What a film that only books light otherwise lets in is what comes in without it, one bounce later."""
    settings = {"method": method, "denoise": False, "direct_samples": 32, "gather": 32}
    film, free = (extract_scene(lit_by_a_window(pane), size=(32, 18)) for pane in ("film", "veil"))
    for bounces in (1, 2):
        through = render(film, RenderSettings(bounces=bounces, **settings)).layers
        without = render(free, RenderSettings(bounces=bounces - 1, **settings)).layers
        expected = (without["Direct"] + without["Indirect"]).mean(dtype=float)
        assert not through["Direct"].any()
        assert through["DiffuseIndirect"].mean(dtype=float) == pytest.approx(expected, rel=0.02)
