"""Every kind of lamp: the irradiance that its extracted numbers imply is the irradiance by Cycles."""

import math

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from lumigate.core.scene import ALL_RAYS, AREA, DIFFUSE, ELLIPSE, GLOSSY, SPOT, SUN, Lamps

DOWN_FROM = Matrix.Translation((0.3, -0.2, 2.0))
TILTED = Matrix.Translation((0.6, 0.3, 1.7)) @ Matrix.Rotation(0.35, 4, "Y") @ Matrix.Rotation(-0.2, 4, "X")


def disk_points(n: int) -> np.ndarray:
    """(M, 2) points evenly over a disk of diameter 1."""
    r = np.sqrt((np.arange(n) + 0.5) / n) / 2
    phi = 2 * np.pi * (np.arange(4 * n) + 0.5) / (4 * n)
    return np.stack([np.outer(r, np.cos(phi)).ravel(), np.outer(r, np.sin(phi)).ravel()], axis=1)


def square_points(n: int) -> np.ndarray:
    """(M, 2) points evenly over a square of side 1."""
    x = (np.arange(n) + 0.5) / n - 0.5
    return np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)


def surface_irradiance(points, sources, facing, radiance, area):
    """Irradiance (P,) on upward `points` from surface samples; `radiance` of the cosine at the source, both (P, S)."""
    to = sources - points[:, None]
    squared = (to**2).sum(-1)
    direction = to / np.sqrt(squared)[..., None]
    cosine = np.maximum(-(direction * facing).sum(-1), 0)
    return (radiance(cosine, direction) * cosine * np.maximum(direction[..., 2], 0) / squared).mean(1) * area


def spot_attenuation(lamps: Lamps, direction: np.ndarray) -> np.ndarray:
    """Cycles' smoothstep of the cosine between the cone's axis and a ray towards the lamp."""
    half = math.cos(0.5 * lamps.angle[0])
    t = (direction @ lamps.axes[0, 2] - half) / ((1 - half) * max(lamps.blend[0], 1e-6))
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def implied_irradiance(lamps: Lamps, origin: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P, 3) irradiance of upward points by the one extracted lamp, from the definitions in core/scene.py."""
    position, kind = lamps.position[0] + origin, lamps.kind[0]
    x, y, z = lamps.axes[0].astype(float)
    if kind == SUN:
        return np.outer(np.full(len(points), z[2]), lamps.emission[0])
    if kind == AREA:
        shape = disk_points(40) if lamps.shape[0] == ELLIPSE else square_points(70)
        size = lamps.size[0]
        sources = (position + shape[:, :1] * size[0] * x + shape[:, 1:] * size[1] * y)[None]
        area = size[0] * size[1] * (math.pi / 4 if lamps.shape[0] == ELLIPSE else 1)
        tan_half = math.tan(0.5 * lamps.angle[0])

        def softbox(cosine, _direction):
            tangent = np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, 1e-9)
            return np.maximum(1 - tangent / tan_half, 0) if lamps.angle[0] < math.pi - 1e-6 else np.ones_like(cosine)

        factor = surface_irradiance(points, sources, -z, softbox, area)
    else:
        axis = points - position
        distance = np.linalg.norm(axis, axis=1, keepdims=True)
        axis /= distance
        radius = float(lamps.radius[0])
        if radius == 0:
            sources, area, lobe = np.broadcast_to(position, (len(points), 1, 3)), 1.0, 1.0
        else:
            # A sphere seen from a point is a disk that faces it: the far circle's, or with soft falloff the middle one.
            soft = bool(lamps.soft_falloff[0])
            shift = np.zeros_like(distance) if soft else radius**2 / distance
            rim = np.full_like(distance, radius) if soft else radius * np.sqrt(1 - (radius / distance) ** 2)
            u = np.cross(axis, [0.9, 0.1, 0.3])
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            v = np.cross(axis, u)
            disk = 2 * disk_points(25)
            sources = (position + shift * axis)[:, None] + rim[:, None] * (disk[:, :1] * u[:, None] + disk[:, 1:] * v[:, None])
            area, lobe = math.pi * rim[:, 0] ** 2, 1 / (math.pi * radius**2)

        def cone(cosine, direction):
            return lobe * (spot_attenuation(lamps, direction) if kind == SPOT else np.ones_like(cosine))

        factor = surface_irradiance(points, sources, axis[:, None], cone, area)
    return np.outer(factor, lamps.emission[0])


LAMPS = {
    "point": ("POINT", DOWN_FROM, dict(energy=50, shadow_soft_size=0)),
    "point colour": ("POINT", DOWN_FROM, dict(energy=50, shadow_soft_size=0, color=(1, 0.5, 0.1))),
    "point sphere": ("POINT", DOWN_FROM, dict(energy=50, shadow_soft_size=0.8, use_soft_falloff=False)),
    "point soft": ("POINT", DOWN_FROM, dict(energy=50, shadow_soft_size=0.8, use_soft_falloff=True)),
    "point raw": ("POINT", DOWN_FROM, dict(energy=5, shadow_soft_size=0, normalize=False)),
    "point sphere raw": ("POINT", DOWN_FROM, dict(energy=5, shadow_soft_size=0.5, normalize=False, use_soft_falloff=False)),
    "point scaled": ("POINT", DOWN_FROM @ Matrix.Scale(3, 4), dict(energy=50, shadow_soft_size=0.5, use_soft_falloff=False)),
    "exposure": ("POINT", DOWN_FROM, dict(energy=50, shadow_soft_size=0, exposure=1.5)),
    "temperature": ("POINT", DOWN_FROM, dict(energy=50, shadow_soft_size=0, use_temperature=True, temperature=3200, color=(0.5, 1, 1))),
    "spot": ("SPOT", TILTED, dict(energy=80, shadow_soft_size=0, spot_size=1.0, spot_blend=0.5)),
    "spot hard": ("SPOT", TILTED, dict(energy=80, shadow_soft_size=0, spot_size=2.2, spot_blend=0.0)),
    "spot sphere": ("SPOT", TILTED, dict(energy=80, shadow_soft_size=0.4, spot_size=1.2, spot_blend=1.0, use_soft_falloff=False)),
    "spot raw": ("SPOT", TILTED, dict(energy=8, shadow_soft_size=0, spot_size=1.0, spot_blend=0.5, normalize=False)),
    "spot scaled": ("SPOT", TILTED @ Matrix.Diagonal((2, 2, 1, 1)), dict(energy=80, shadow_soft_size=0, spot_size=0.6, spot_blend=0.0)),
    "sun": ("SUN", TILTED, dict(energy=3, angle=0)),
    "sun disc": ("SUN", TILTED, dict(energy=3, angle=0.6)),
    "sun disc raw": ("SUN", TILTED, dict(energy=3, angle=0.6, normalize=False)),
    "sun scaled": ("SUN", TILTED @ Matrix.Scale(2, 4), dict(energy=3, angle=0.3)),
    "square": ("AREA", TILTED, dict(energy=50, shape="SQUARE", size=0.8)),
    "rectangle": ("AREA", TILTED, dict(energy=50, shape="RECTANGLE", size=0.5, size_y=1.5)),
    "disk": ("AREA", TILTED, dict(energy=50, shape="DISK", size=1.0)),
    "ellipse": ("AREA", TILTED, dict(energy=50, shape="ELLIPSE", size=0.5, size_y=1.5)),
    "area raw": ("AREA", TILTED, dict(energy=10, shape="RECTANGLE", size=0.5, size_y=1.5, normalize=False)),
    "area spread": ("AREA", TILTED, dict(energy=50, shape="SQUARE", size=1.5, spread=1.2)),
    "disk spread": ("AREA", TILTED, dict(energy=50, shape="DISK", size=1.5, spread=0.5)),
    "area scaled": ("AREA", TILTED @ Matrix.Diagonal((2, 0.5, 3, 1)), dict(energy=50, shape="SQUARE", size=0.8)),
    "area mirrored": ("AREA", TILTED @ Matrix.Diagonal((-1.5, 1, 1, 1)), dict(energy=50, shape="RECTANGLE", size=0.5, size_y=1.0, spread=1.5)),
}  # fmt: skip


@pytest.mark.parametrize("case", LAMPS)
def test_irradiance_is_that_of_cycles(stage, cycles_irradiance, case):
    kind, matrix, settings = LAMPS[case]
    stage.receiver()
    stage.lamp(kind, matrix, **settings)
    extracted = stage.extract()
    assert len(extracted.lamps) == 1, extracted.skipped
    expected = cycles_irradiance(64)
    implied = implied_irradiance(extracted.lamps, extracted.origin, stage.pixel_points)
    assert expected.max() > 0.05
    np.testing.assert_allclose(implied.mean(0), expected.mean(0), rtol=0.01)
    # Pixel by pixel, so that a shape cannot be wrong with the right total; a hard cone's edge is excused.
    off = np.abs(implied - expected) > 0.06 * expected.max()
    assert off.mean() < 0.02


def test_parallel_area_light_keeps_its_power(stage, cycles_irradiance):
    stage.receiver()
    stage.lamp("AREA", Matrix.Translation((0, 0, 2)), energy=30, shape="SQUARE", size=3, spread=0)
    lamps = stage.extract().lamps
    half = float(lamps.angle[0]) / 2
    angle = (np.arange(1000) + 0.5) / 1000 * half
    lobe = (1 - np.tan(angle) / math.tan(half)) * np.cos(angle) * np.sin(angle)
    on_the_floor = lamps.emission[0] * 2 * math.pi * lobe.sum() * half / 1000
    np.testing.assert_allclose(on_the_floor, cycles_irradiance(16).mean(0), rtol=0.01)


def with_nodes(stage, build):
    lamp = stage.lamp("POINT", DOWN_FROM, energy=50, shadow_soft_size=0)
    tree = stage.nodes(lamp.data)
    build(tree, next(node for node in tree.nodes if node.type == "EMISSION"))
    return lamp


def test_constant_nodes_multiply(stage, cycles_irradiance):
    def build(tree, emission):
        color, falloff, math_node = (tree.nodes.new("ShaderNode" + n) for n in ("RGB", "LightFalloff", "Math"))
        color.outputs[0].default_value = 0.2, 0.4, 0.8, 1
        falloff.inputs["Strength"].default_value = 3
        math_node.operation = "MULTIPLY"
        math_node.inputs[1].default_value = 0.5
        tree.links.new(color.outputs[0], emission.inputs["Color"])
        tree.links.new(falloff.outputs["Quadratic"], math_node.inputs[0])
        tree.links.new(math_node.outputs[0], emission.inputs["Strength"])

    stage.receiver()
    with_nodes(stage, build)
    scene = stage.extract()
    assert not scene.warnings
    implied = implied_irradiance(scene.lamps, scene.origin, stage.pixel_points)
    np.testing.assert_allclose(implied.mean(0), cycles_irradiance(16).mean(0), rtol=0.01)


@pytest.mark.parametrize(("output", "smooth", "falloff"), [("Linear", 0, (1, 0)), ("Constant", 0.5, (2, 0.5)), ("Quadratic", 2, (0, 2))])
def test_light_falloff(stage, output, smooth, falloff):
    def build(tree, emission):
        node, double = tree.nodes.new("ShaderNodeLightFalloff"), tree.nodes.new("ShaderNodeMath")
        node.inputs["Strength"].default_value, node.inputs["Smooth"].default_value = 3, smooth
        double.operation = build.operation
        double.inputs[1].default_value = 2
        tree.links.new(node.outputs[output], double.inputs[0])
        tree.links.new(double.outputs[0], emission.inputs["Strength"])

    stage.cube()
    build.operation = "MULTIPLY"
    lamp = with_nodes(stage, build)
    scene = stage.extract()
    assert not scene.warnings
    np.testing.assert_allclose(scene.lamps.falloff, [falloff], rtol=1e-6)
    np.testing.assert_allclose(scene.lamps.emission[0], 6 * 50 / (4 * math.pi), rtol=1e-6)
    bpy.data.objects.remove(lamp)
    build.operation = "ADD"
    with_nodes(stage, build)
    scene = stage.extract()
    assert any("vary" in warning for warning in scene.warnings)
    assert not scene.lamps.falloff.any()


def test_blackbody_in_a_group_multiplies(stage, cycles_irradiance):
    group = bpy.data.node_groups.new("Warm", "ShaderNodeTree")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    blackbody, end = group.nodes.new("ShaderNodeBlackbody"), group.nodes.new("NodeGroupOutput")
    blackbody.inputs[0].default_value = 2700
    group.links.new(blackbody.outputs[0], end.inputs[0])

    def build(tree, emission):
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        tree.links.new(node.outputs[0], emission.inputs["Color"])

    stage.receiver()
    with_nodes(stage, build)
    scene = stage.extract()
    implied = implied_irradiance(scene.lamps, scene.origin, stage.pixel_points)
    np.testing.assert_allclose(implied.mean(0), cycles_irradiance(16).mean(0), rtol=0.01)


@pytest.mark.parametrize(("node", "output", "named"), [("TexGabor", "Value", "Gabor"), ("LightPath", "Ray Length", "Ray Length")])
def test_nodes_that_are_not_known_are_named_in_a_warning(stage, node, output, named):
    stage.cube()
    with_nodes(
        stage, lambda tree, emission: tree.links.new(tree.nodes.new(f"ShaderNode{node}").outputs[output], emission.inputs["Strength"])
    )
    scene = stage.extract()
    assert any("'Point'" in warning and named in warning for warning in scene.warnings)
    assert scene.lamps.program.tolist() == [-1]
    np.testing.assert_allclose(scene.lamps.emission[0], 50 / (4 * math.pi), rtol=1e-6)


def test_a_limit_of_bounces_is_named_in_a_warning(stage):
    stage.cube()
    lamp = stage.lamp("POINT", DOWN_FROM, energy=50)
    assert not stage.extract().warnings
    lamp.data.cycles.max_bounces = 1
    assert [warning for warning in stage.extract().warnings if "Max Bounces 1" in warning and f"'{lamp.name}'" in warning]


def test_a_lamp_for_glossy_rays_only(stage):
    stage.cube()
    lamp = stage.lamp("POINT", DOWN_FROM, energy=50)
    lamp.visible_diffuse = False
    scene = stage.extract()
    assert not scene.warnings
    assert scene.lamps.visibility[0] & (DIFFUSE | GLOSSY) == GLOSSY


def test_nodes_without_surface_are_dark(stage):
    stage.cube()
    with_nodes(stage, lambda tree, emission: tree.nodes.remove(emission))
    scene = stage.extract()
    assert len(scene.lamps) == 0
    assert "no power" in scene.skipped[0].reason


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda ob: setattr(ob.data, "energy", 0), "no power"),
        (lambda ob: setattr(ob.data, "color", (0, 0, 0)), "no power"),
        (lambda ob: setattr(ob.data, "energy", -5), "negative"),
        (lambda ob: setattr(ob, "hide_render", True), "hidden"),
        (lambda ob: setattr(ob.data.cycles, "is_portal", True), "portal"),
        (lambda ob: setattr(ob, "scale", (0, 1, 1)), "scale"),
        (lambda ob: setattr(ob.data, "size", 0), "size"),
    ],
)
def test_lamps_that_shine_nothing_are_skipped_by_name(stage, spoil, reason):
    stage.cube()
    spoil(stage.lamp("AREA", energy=10))
    scene = stage.extract()
    assert len(scene.lamps) == 0
    assert [(s.stage, "'Area'" in s.reason, reason in s.reason) for s in scene.skipped] == [("lamps", True, True)]


@pytest.mark.parametrize(("shape", "size"), [("RECTANGLE", (2.0, 3.0)), ("SQUARE", (2.0, 1.5)), ("ELLIPSE", (2.0, 3.0))])
def test_portals_are_the_worlds(stage, shape, size):
    stage.cube().location = 100, 0, 0
    place = Matrix.Translation((101, 2, 3)) @ Matrix.Rotation(0.5, 4, "X") @ Matrix.Diagonal((2, 1.5, 1, 1))
    lamp = stage.lamp("AREA", place, energy=10, shape=shape, size=1.0, size_y=2.0)
    lamp.data.cycles.is_portal = True
    scene = stage.extract()
    (portal,) = scene.world.portals + np.outer((1, 0, 0), scene.origin)
    np.testing.assert_allclose(portal[0], (101, 2, 3), atol=1e-4)
    np.testing.assert_allclose(2 * np.linalg.norm(portal[1:], axis=1), size, rtol=1e-5)
    # It faces where the lamp would shine, along its -z axis.
    facing = np.cross(portal[2], portal[1])
    np.testing.assert_allclose(facing / np.linalg.norm(facing), -np.array(place.to_3x3().normalized().col[2]), atol=1e-5)
    lamp.data.size = 0
    assert not len(stage.extract().world.portals)


@pytest.mark.parametrize("energy", [-5, 0, 5])
def test_a_lamp_that_darkens_in_cycles_is_warned_of(stage, energy):
    stage.cube()
    stage.lamp("AREA", energy=energy)
    assert any("'Area'" in warning and "negative" in warning for warning in stage.extract().warnings) == (energy < 0)


def test_switches_groups_and_place(stage):
    stage.cube().location = 100, 0, 0
    lamp = stage.lamp("POINT", Matrix.Translation((101, 2, 3)), energy=1, use_shadow=False)
    lamp.visible_camera, lamp.visible_diffuse = True, False
    stage.scene.view_layers[0].lightgroups.add(name="key")
    lamp.lightgroup = "key"
    scene = stage.extract()
    assert scene.lamps.names == ["Point"] and scene.lamps.groups == ["key"]
    assert scene.lamps.visibility[0] == ALL_RAYS & ~DIFFUSE
    assert scene.lamps.cast_shadow[0] == 0
    np.testing.assert_allclose(scene.lamps.position[0] + scene.origin, (101, 2, 3), atol=1e-5)


def test_instanced_lamps_shine_where_their_instances_are(stage):
    stage.cube()
    collection = bpy.data.collections.new("Lights")
    light = bpy.data.lights.new("Bulb", "POINT")
    collection.objects.link(bpy.data.objects.new("Bulb", light))
    for x in (1, 2, 3):
        instancer = stage.link("Instancer", None, Matrix.Translation((x, 0, 0)))
        instancer.instance_type, instancer.instance_collection = "COLLECTION", collection
    lamps = stage.extract().lamps
    assert lamps.names == ["Bulb"] * 3
    np.testing.assert_allclose(np.sort(lamps.position[:, 0]), (1, 2, 3), atol=1e-6)


def test_elliptic_spot_cone_is_named_in_a_warning(stage):
    stage.cube()
    stage.lamp("SPOT", Matrix.Diagonal((1, 2, 1, 1)), energy=1)
    assert any("'Spot'" in warning for warning in stage.extract().warnings)


def test_elliptic_spot_cone_keeps_its_solid_angle(stage):
    stage.cube()
    stage.lamp("SPOT", Matrix.Diagonal((2, 0.5, 1, 1)), energy=1, spot_size=0.4)
    assert stage.extract().lamps.angle[0] == pytest.approx(0.4, rel=1e-5)


def test_a_flattened_point_lamp_shines_as_ever(stage):
    stage.cube()
    stage.lamp("POINT", Matrix.Translation((0, 0, 3)) @ Matrix.Diagonal((1, 1, 0, 1)), energy=10)
    lamps = stage.extract().lamps
    assert lamps.names and np.isfinite(lamps.axes).all() and lamps.emission.all()


def test_lamps_that_are_alike_share_a_program(stage):
    stage.cube()

    def build(tree, emission):
        tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], emission.inputs["Strength"])

    first = with_nodes(stage, build)
    again = stage.link("Again", first.data, Matrix.Translation((1, 2, 3)))
    scene = stage.extract()
    assert not scene.warnings
    assert len(set(scene.lamps.program)) == 1
    assert scene.lamps.program[0] == len(scene.materials.names) - 1
    again.scale = (2, 2, 2)
    assert len(set(stage.extract().lamps.program)) == 2  # the noise is as much larger


def test_falloff_beside_a_texture(stage):
    stage.cube()

    def build(tree, emission):
        falloff, noise, math_node = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("LightFalloff", "TexNoise", "Math"))
        math_node.operation = build.operation
        tree.links.new(falloff.outputs["Linear"], math_node.inputs[0])
        tree.links.new(noise.outputs[0], math_node.inputs[1])
        tree.links.new(math_node.outputs[0], emission.inputs["Strength"])

    build.operation = "MULTIPLY"
    lamp = with_nodes(stage, build)
    scene = stage.extract()
    assert not scene.warnings
    assert scene.lamps.falloff.tolist() == [[1, 0]]
    bpy.data.objects.remove(lamp)
    build.operation = "ADD"
    with_nodes(stage, build)
    scene = stage.extract()
    assert any("in proportion" in warning for warning in scene.warnings)
    assert scene.lamps.program.tolist() == [-1]
    assert not scene.lamps.falloff.any()


@pytest.mark.parametrize("kind", ["AREA", "SPOT", "SUN"])
def test_a_lamp_that_is_sheared_has_axes_at_right_angles(stage, kind):
    """A turned lamp below a parent of an uneven scale: its rays were aimed beside it, in part behind walls."""
    turned = (Matrix.Diagonal((2.0, 1.0, 0.5, 1.0)) @ Matrix.Rotation(0.5, 4, "X") @ Matrix.Rotation(0.4, 4, "Y")).to_3x3()
    parent = bpy.data.objects.new("Parent", None)
    parent.scale = 2.0, 1.0, 0.5
    stage.scene.collection.objects.link(parent)
    lamp = stage.lamp(kind, Matrix.Rotation(0.5, 4, "X") @ Matrix.Rotation(0.4, 4, "Y"))
    lamp.parent = parent
    lamps = stage.extract().lamps
    axes = lamps.axes.reshape(3, 3)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-6)
    x, y, z = (np.array(axis) / np.linalg.norm(axis) for axis in turned.col)
    if kind == "AREA":  # in the plane of its sides
        across = np.cross(x, y)
        np.testing.assert_allclose(axes[2], across / np.linalg.norm(across), atol=1e-6)
        np.testing.assert_allclose(axes[0], x, atol=1e-6)
    else:
        np.testing.assert_allclose(axes[2], z, atol=1e-6)
