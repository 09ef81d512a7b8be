"""Direct light of every lamp against closed forms and quadrature; particles against direct light."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.jit import kernel
from lumigate.core.lamps import build_emitters, direct_irradiance
from lumigate.core.lamps.direct import direct_irradiance_at
from lumigate.core.lamps.emission import FOR_EVER, emit, focused
from lumigate.core.lamps.sample import sample_emitter
from lumigate.core.lamps.shapes import AWAY_FROM_CENTRE
from lumigate.core.lamps.tables import WITHIN
from lumigate.core.lamps.within import share_within
from lumigate.core.particles import trace_particles
from lumigate.core.rays import RayScene, new_packet
from lumigate.core.sampling.sequences import sobol
from lumigate.core.surfaces.layout import SURFACE, TRANSPARENCY
from lumigate.core.surfaces.program import ATTRIBUTE, BACKFACING, EMISSION_CLOSURE, END, REGISTERS, SCALE, new_registers
from lumigate.core.transport import transport
from lumigate.headless.stress.arrays import camera, geometry, materials, quads

UP = (0.0, 0.0, 1.0)
RECEIVER = [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)]
EMISSIVE_QUAD = [(0.5, -0.4, 0.3), (0.9, 0.5, 0.5), (0.2, 0.6, 1.5), (-0.2, -0.3, 1.3)]
AWAY = [(90, 90, 0), (90.1, 90, 0), (90.1, 90.1, 0), (90, 90.1, 0)]  # where nothing must stand in the way


def axes_towards(direction, roll=0.4):
    """Axes (3, 3) of a lamp that shines along `direction`, turned by `roll` about it."""
    z = -np.asarray(direction, float) / np.linalg.norm(direction)
    x = np.cross([0.3, 1, 0.2], z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    return np.stack([math.cos(roll) * x + math.sin(roll) * y, math.cos(roll) * y - math.sin(roll) * x, z])


def lamp(
    kind, emission, position=(0, 0, 2), towards=(0, 0, -1), radius=0.0, soft=0, angle=math.pi, blend=0.0, size=(1, 1), shape=0, shadow=1
):
    """One lamp as keyword columns."""
    return dict(
        kind=kind, emission=np.broadcast_to(emission, 3), position=position, axes=axes_towards(towards), radius=radius, soft_falloff=soft,
        angle=angle, blend=blend, size=size, shape=shape, visibility=sc.ALL_RAYS, cast_shadow=shadow,
    )  # fmt: skip


def lamps_of(*rows):
    empty = sc.Lamps.empty()
    columns = {k: np.array([r[k] for r in rows], getattr(empty, k).dtype) for k in rows[0]} if rows else {}
    return sc.Lamps(**columns, names=[f"lamp {i}" for i in range(len(rows))], groups=[""] * len(rows)) if rows else empty


def scene_of(*rows, world=0.0, quad=(RECEIVER,), material=None, surfaces=((0.5, 0.0),)):
    """Quads (the first is the receiving plane z = 0), lamps and a world."""
    vertices, triangles = quads(*quad)
    g = geometry(vertices, triangles, None if material is None else np.repeat(material, 2))
    radiance = np.asarray(world, np.float32)
    radiance = np.full((1, 1, 3), radiance, np.float32) if radiance.ndim == 0 else radiance
    return sc.Scene(g, materials(*surfaces), lamps_of(*rows), sc.World(radiance), camera())


class Lit:
    """A scene ready for direct light."""

    def __init__(self, scene):
        g = scene.geometry
        transparent = (scene.materials.tables.flags[g.material] & sc.TRANSPARENT) != 0
        self.rays = RayScene(g.vertices, g.triangles, g.object_visibility[g.object], transparent)
        self.emitters = build_emitters(scene)
        self.tables = transport(g, scene.materials.tables, self.rays.tables, self.emitters)

    def __call__(self, points, samples=256, normal=UP, ng=None, seed=1, copies=16, first=0):
        """Irradiance (N, 3) float64 at points, each the mean of `copies` independent estimates."""
        points = np.atleast_2d(np.asarray(points, np.float32))
        position = np.repeat(points, copies, 0)
        n = np.tile(np.float32(normal), (len(position), 1))
        g = n if ng is None else np.tile(np.float32(ng), (len(position), 1))
        points = SimpleNamespace(position=position, ns=n, ng=g, error=np.full(len(position), 1e-6, np.float32))
        e, self.n_rays = direct_irradiance(self.tables, points, samples, seed, first=first)
        self.raw = e
        return e.astype(np.float64).reshape(-1, copies, 3).mean(1)


def lit(*rows, **options):
    return Lit(scene_of(*rows, **options))


# -- closed forms ------------------------------------------------------------------------------------------


def test_point_over_plane():
    e = lit(lamp(sc.POINT, (10, 20, 5), (0.5, 0, 2)))([[0, 0, 0], [0.5, 0, 0], [-3, 2, 0]])
    d = np.array([[0.5, 0, 2], [0, 0, 2], [3.5, -2, 2]])
    r = np.linalg.norm(d, axis=1)
    assert np.allclose(e, (d[:, 2] / r**3)[:, None] * [10, 20, 5], rtol=1e-5)


def test_sphere_lamp_is_a_point_from_outside():
    """Seen whole above the horizon, a sphere lights like a point of its intensity."""
    e = lit(lamp(sc.POINT, 10, (0.3, 0.2, 2), radius=0.7))([[0, 0, 0], [1, 1, 0]])
    d = np.array([[0.3, 0.2, 2], [-0.7, -0.8, 2]])
    assert np.allclose(e[:, 0], 10 * 2 / np.linalg.norm(d, axis=1) ** 3, rtol=1e-4)


def test_soft_lamp_is_a_disk_that_faces_the_point():
    e = lit(lamp(sc.POINT, 10, (0.3, 0.2, 2), radius=0.7, soft=1))([[0, 0, 0]])
    d2 = 0.09 + 0.04 + 4
    # A facing disk of radius r at distance d: L pi r^2 / (d^2 + r^2), tilted by the cosine while above the horizon.
    assert np.allclose(e, 10 / (d2 + 0.49) * 2 / math.sqrt(d2), rtol=1e-4)


def test_inside_a_sphere_lamp():
    e = lit(lamp(sc.POINT, 10, (0, 0, 0.3), radius=2.0))([[0, 0, 0]])
    assert np.allclose(e, math.pi * 10 / (math.pi * 4), rtol=1e-4)


@pytest.mark.parametrize("shape,size", [(sc.ELLIPSE, (3, 3)), (sc.ELLIPSE, (0.02, 0.02))])
def test_disk_on_its_axis(shape, size):
    """Radiance L over a disk of radius r at height h: E = pi L r^2 / (r^2 + h^2)."""
    e = lit(lamp(sc.AREA, (7, 3, 1), (0, 0, 1.5), size=size, shape=shape))([[0, 0, 0]], samples=2048)
    r = size[0] / 2
    assert np.allclose(e, np.pi * np.array([7, 3, 1]) * r * r / (r * r + 2.25), rtol=2e-3)


def rectangle_factor(a, b, c):
    """Form factor of a differential patch to a parallel a x b rectangle at height c with a corner above the patch."""
    x, y = a / c, b / c
    s, t = math.sqrt(1 + x * x), math.sqrt(1 + y * y)
    return (x / s * math.atan(y / s) + y / t * math.atan(x / t)) / (2 * math.pi)


@pytest.mark.parametrize("height", [0.02, 0.5, 3.0, 400.0])
def test_rectangle(height):
    row = lamp(sc.AREA, 5, (0, 0, height), size=(2, 1))
    row["axes"] = np.diag([1.0, 1, 1])
    e = lit(row)([[0, 0, 0]])
    assert np.allclose(e, 5 * math.pi * 4 * rectangle_factor(1, 0.5, height), rtol=1e-3)


@pytest.mark.parametrize("size", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
def test_small_rectangles(size):
    """Each lights like a patch of its area: what it subtends is far less than what angles in float32 are rounded to."""
    at = np.array([[0, 0, 0], [1.3, -0.4, 0], [-3, 2, 0]])
    row = lamp(sc.AREA, 5 / size**2, (0.4, 0.3, 2), size=(size, size))
    row["axes"] = np.diag([1.0, 1, 1])
    d2 = np.sum((at - [0.4, 0.3, 2]) ** 2, axis=1)
    e = lit(row)(at)
    assert np.allclose(e, (5 * 4 / d2**2)[:, None], rtol=1e-3)


def test_area_lamp_shines_forwards_only():
    assert not lit(lamp(sc.AREA, 5, (0, 0, 1), towards=(0, 0, 1)))([[0, 0, 0]]).any()


@pytest.mark.parametrize("angle", [0.0, 0.01, 1.0])
def test_sun(angle):
    """Irradiance on a plane that faces the sun is given; tilted by the cosine."""
    towards = np.array([0.3, -0.4, -0.8])
    e = lit(lamp(sc.SUN, (3, 2, 1), towards=towards, angle=angle))([[0, 0, 0]], normal=-towards / np.linalg.norm(towards))
    assert np.allclose(e, [[3, 2, 1]], rtol=1e-3)
    e = lit(lamp(sc.SUN, (3, 2, 1), towards=towards, angle=angle))([[0, 0, 0]])
    assert np.allclose(e, np.array([[3, 2, 1]]) * 0.8 / np.linalg.norm(towards), rtol=1e-3)


def test_constant_world_on_an_open_plane():
    assert np.allclose(lit(world=0.7)([[0, 0, 0]]), 0.7 * math.pi, rtol=1e-5)
    assert lit(world=0.7)([[0, 0, 0]], samples=1, copies=1) == pytest.approx(0.7 * math.pi, rel=1e-5)


def test_square_emitter_of_two_triangles_shines_from_both_sides():
    for flip in (1, -1):
        quad = [(-1, -flip, 3), (1, -flip, 3), (1, flip, 3), (-1, flip, 3)]
        e = lit(quad=(RECEIVER, quad), material=[0, 1], surfaces=((0.5, 0), (0, (10, 5, 1))))([[0, 0, 0]])
        assert np.allclose(e, math.pi * 4 * rectangle_factor(1, 1, 3) * np.array([10, 5, 1]), rtol=1e-3)


def test_shadows():
    blocker = [(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
    below = [[0, 0, 0], [3.9, 0, 0]]
    for rows in ([lamp(sc.POINT, 10, (0, 0, 3))], [lamp(sc.SUN, 3, angle=0.05)], [lamp(sc.AREA, 3, (0, 0, 3))]):
        open_plane, blocked = lit(*rows)(below), lit(*rows, quad=(RECEIVER, blocker))(below)
        assert not blocked[0].any() and np.allclose(
            blocked[1], open_plane[1], rtol=1e-4, atol=0
        )  # neighbours in the shadow have a say in where rays go
        rows[0]["cast_shadow"] = 0
        assert np.allclose(lit(*rows, quad=(RECEIVER, blocker))(below), open_plane, rtol=1e-5)


def test_cut_outs_let_their_share_through():
    blocker = [(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
    above = [(-1, -1, 2), (1, -1, 2), (1, 1, 2), (-1, 1, 2)]
    for rows in ([lamp(sc.POINT, 10, (0.1, 0, 3))], [lamp(sc.SUN, 3, angle=0)], [lamp(sc.POINT, 1, (0.1 * k, 0, 3)) for k in range(10)]):
        scene = scene_of(*rows, quad=(RECEIVER, blocker, above), material=[0, 1, 1], surfaces=((0.5, 0), (0, 0)))
        tables = scene.materials.tables
        tables.flags[1] |= sc.TRANSPARENT
        tables.constant[1, TRANSPARENCY : TRANSPARENCY + 3] = 0.9, 0.5, 0.0
        below = [[0, 0.1, 0]]
        expected = lit(*rows)(below) * np.array([0.81, 0.25, 0])
        light = Lit(scene)
        assert np.allclose(light(below), expected, rtol=0.02)
        single = one_ray_each(light.tables, np.float32(below[0]), 20000, np.uint32(1))
        assert np.allclose(single, expected[0], rtol=0.02)


def test_objects_that_cast_no_shadow():
    blocker = [(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
    scene = scene_of(lamp(sc.POINT, 10, (0, 0, 3)), quad=(RECEIVER, blocker))
    g = scene.geometry
    g.object[2:] = 1
    g.object_names, g.object_visibility = ["floor", "blocker"], np.array([sc.ALL_RAYS, sc.ALL_RAYS & ~sc.SHADOW], np.uint8)
    assert np.allclose(Lit(scene)([[0, 0, 0]]), 10 / 9, rtol=1e-5)


def test_world_through_a_skylight():
    """Under a ceiling with a square hole the world lights like a rectangle of its radiance."""
    h, w = 2.0, 400.0
    ceiling = [[(-w, -w, h), (-1, -w, h), (-1, w, h), (-w, w, h)], [(1, -w, h), (w, -w, h), (w, w, h), (1, w, h)],
               [(-1, -w, h), (1, -w, h), (1, -1, h), (-1, -1, h)], [(-1, 1, h), (1, 1, h), (1, w, h), (-1, w, h)]]  # fmt: skip
    e = lit(world=2.0, quad=(RECEIVER, *ceiling))([[0, 0, 0]], samples=4096)
    around = math.pi * (1 - 4 * rectangle_factor(w, w, h))
    assert np.allclose(e, 2 * (math.pi * 4 * rectangle_factor(1, 1, h) + around), rtol=3e-3)


def test_light_below_either_horizon_gives_nothing():
    one = lit(lamp(sc.POINT, 10, (2, 0, 0.5)))
    tilted = np.array([0.9, 0, -0.44])
    assert not one([[0, 0, 1]], normal=UP, ng=UP).any()
    assert not one([[0, 0, 0]], normal=-tilted / np.linalg.norm(tilted), ng=UP).any()
    assert not one([[0, 0, 1]], normal=(0.9, 0, 0.436), ng=UP).any()
    assert one([[0, 0, 1]], normal=(1, 0, 0), ng=(1, 0, 0)).all()


def test_lamps_that_face_away_get_no_rays_however_near():
    """A ceiling beside a lamp that hangs from it lies within the sphere about the lamp, but behind it."""
    far = lamp(sc.POINT, 40, (1.5, 0, 2))
    near = lamp(sc.AREA, 10, (0, 0, -0.005), towards=(0, 0, -1), size=(0.3, 0.3))
    places = [[0.02, 0.01, 0.0], [0.2, 0.1, 0.0]]
    alone, both = lit(far, quad=(AWAY,)), lit(near, far, quad=(AWAY,))
    # The far lamp has no size: were the one ray there is not always its own, the light would vary.
    np.testing.assert_allclose(both(places, samples=1), alone(places, samples=1), rtol=1e-4)


def test_what_is_left_out():
    dark, hidden = lamp(sc.POINT, 0), lamp(sc.POINT, 5)
    hidden["visibility"] = sc.ALL_RAYS & ~sc.DIFFUSE
    broken = lamp(sc.AREA, np.inf)
    scene = scene_of(dark, hidden, broken, lamp(sc.POINT, 5), world=3.0)
    scene.world.visibility = sc.CAMERA
    emitters = build_emitters(scene)
    assert emitters.source.tolist() == [3] and len(emitters.kind) == 1
    assert len(scene.warnings) == 1 and "lamp 2" in scene.warnings[0]
    assert len(build_emitters(scene, sc.GLOSSY).kind) == 2
    nothing = Lit(scene_of())
    assert not nothing([[0, 0, 0]]).any() and not emitted(nothing.emitters, 64)[0].any()


# -- quadrature --------------------------------------------------------------------------------------------


def spot_attenuation(cosine, angle, blend):
    outer = math.cos(angle / 2)
    x = np.clip((cosine - outer) / max((1 - outer) * blend, 1e-9), 0, 1)
    return x * x * (3 - 2 * x)


def area_quadrature(row, p, n, cells=700):
    """Irradiance of an area lamp by midpoints over its surface, float64."""
    s = (np.arange(cells) + 0.5) / cells - 0.5
    u, v = np.meshgrid(s, s)
    inside = u * u + v * v <= 0.25 if row["shape"] == sc.ELLIPSE else np.ones_like(u, bool)
    w, h = row["size"]
    x, y, z = row["axes"]
    q = np.array(row["position"]) + (u * w)[..., None] * x + (v * h)[..., None] * y
    d = q - p
    r = np.linalg.norm(d, axis=-1)
    d /= r[..., None]
    cos_l = np.maximum(d @ z, 1e-12)
    attenuation = np.maximum(1 - np.sqrt(1 / cos_l**2 - 1) / np.tan(min(row["angle"], math.pi - 1e-9) / 2), 0)
    return row["emission"] * (np.maximum(d @ n, 0) * cos_l / r**2 * attenuation * inside * (d @ z > 0)).sum() * w * h / cells**2


def disk_quadrature(row, p, n, cells=700):
    """Irradiance of a soft point or spot lamp by midpoints over the disk that faces p, float64."""
    axis = p - np.array(row["position"])
    axis /= np.linalg.norm(axis)
    a = axes_towards(axis)
    s = (np.arange(cells) + 0.5) / cells * 2 - 1
    u, v = np.meshgrid(s, s)
    q = np.array(row["position"]) + row["radius"] * (u[..., None] * a[0] + v[..., None] * a[1])
    d = q - p
    r = np.linalg.norm(d, axis=-1)
    d /= r[..., None]
    value = np.maximum(d @ n, 0) * -(d @ axis) / r**2 * (u * u + v * v <= 1)
    if row["kind"] == sc.SPOT:
        value = value * spot_attenuation(d @ row["axes"][2], row["angle"], row["blend"])
    return row["emission"] * value.sum() * (2 / cells) ** 2 / math.pi


TILT = np.array([0.2, -0.5, 0.6]) / np.linalg.norm([0.2, -0.5, 0.6])
AREAS = {
    "tilted": lamp(sc.AREA, (5, 4, 3), (0.4, 0.3, 1.2), (0.3, 0.2, -1), size=(1.5, 0.7)),
    "through the horizon": lamp(sc.AREA, 5, (1.5, 0.0, 0.2), (-1, 0, -0.1), size=(1.5, 1.5)),
    "ellipse": lamp(sc.AREA, 5, (0.4, 0.3, 1.2), (0.3, 0.2, -1), size=(1.5, 0.7), shape=sc.ELLIPSE),
    "far ellipse": lamp(sc.AREA, 5, (2.4, 0.3, 3.2), (-0.6, 0.2, -1), size=(0.5, 0.7), shape=sc.ELLIPSE),
    "spread": lamp(sc.AREA, 5, (0.4, 0.3, 1.2), (-0.3, 0.1, -1), size=(1.5, 0.7), angle=math.radians(100)),
    "narrow spread": lamp(sc.AREA, 5, (0.1, 0.1, 2), (-0.1, 0.1, -1), size=(1.5, 1.7), angle=math.radians(20)),
    "ellipse with spread": lamp(sc.AREA, 5, (0.3, 0.1, 1), (-0.1, 0.1, -1), size=(1, 2), angle=math.radians(60), shape=sc.ELLIPSE),
}


@pytest.mark.parametrize("name", AREAS)
@pytest.mark.parametrize("normal", [UP, tuple(TILT)])
def test_area_lamps_by_quadrature(name, normal):
    p = np.array([0.1, -0.2, 0.05])
    e = lit(AREAS[name], quad=(AWAY,))([p], normal=normal, samples=1024)
    assert np.allclose(e[0], area_quadrature(AREAS[name], p, np.array(normal)), rtol=3e-3)


SPOTS = {
    "hard": lamp(sc.SPOT, 10, (0.5, 0.2, 2), (-0.2, -0.1, -1), angle=1.0),
    "smooth": lamp(sc.SPOT, 10, (0.5, 0.2, 2), (-0.5, -0.2, -1), angle=1.0, blend=0.6),
    "fully smooth": lamp(sc.SPOT, 10, (0.5, 0.2, 2), (0.0, -0.1, -1), angle=2.4, blend=1.0),
}


@pytest.mark.parametrize("name", SPOTS)
def test_spots_without_size(name):
    row, p = SPOTS[name], np.array([0.1, -0.2, 0.05])
    d = np.array(row["position"]) - p
    r = np.linalg.norm(d)
    expected = row["emission"] * spot_attenuation(d / r @ row["axes"][2], row["angle"], row["blend"]) * d[2] / r**3
    assert np.allclose(lit(row)([p], samples=1, copies=1)[0], expected, rtol=1e-4)


@pytest.mark.parametrize("kind,soft", [(sc.SPOT, 1), (sc.POINT, 1)])
def test_soft_lamps_by_quadrature(kind, soft):
    row = lamp(kind, 10, (0.5, 0.2, 0.8), (-0.2, -0.1, -1), angle=1.6, blend=0.5, radius=0.5, soft=soft)
    p = np.array([0.1, -0.2, 0.05])
    e = lit(row, quad=(AWAY,))([p], normal=TILT, samples=1024)
    assert np.allclose(e[0], disk_quadrature(row, p, TILT), rtol=2e-3)


def test_sphere_spot_by_quadrature():
    """Radiance I / (pi r^2) over the visible part of the sphere, attenuated by direction."""
    row = lamp(sc.SPOT, 10, (0.5, 0.2, 0.9), (-0.2, -0.1, -1), angle=1.6, blend=0.5, radius=0.4)
    p = np.array([0.1, -0.2, 0.05])
    axis = np.array(row["position"]) - p
    d = np.linalg.norm(axis)
    x, y, z = axes_towards(-axis)
    cos_max = math.sqrt(1 - 0.16 / d**2)
    c = cos_max + (1 - cos_max) * (np.arange(800) + 0.5)[:, None] / 800
    phi = 2 * np.pi * (np.arange(800) + 0.5)[None] / 800
    s = np.sqrt(1 - c * c)
    w = s[..., None] * (np.cos(phi)[..., None] * x + np.sin(phi)[..., None] * y) + c[..., None] * z
    mean = (np.maximum(w @ TILT, 0) * spot_attenuation(w @ row["axes"][2], 1.6, 0.5)).mean()
    expected = 10 / (math.pi * 0.16) * mean * 2 * math.pi * (1 - cos_max)
    assert np.allclose(lit(row, quad=(AWAY,))([p], normal=TILT, samples=1024)[0], expected, rtol=2e-3)


def sky(height=24, width=48):
    """A world with a gradient and one small bright sun."""
    rng = np.random.default_rng(3)
    image = rng.random((height, width, 3)) * np.linspace(2, 0.1, height)[:, None, None]
    image[5, 7] = [300, 250, 200]
    return image.astype(np.float32)


def world_quadrature(image, normal, fine=8):
    image = np.repeat(np.repeat(image.astype(np.float64), fine, 0), fine, 1)
    h, w = image.shape[:2]
    edges = np.cos(np.pi * np.arange(h + 1) / h)
    z = 0.5 * (edges[:-1] + edges[1:])[:, None] * np.ones((1, w))
    phi = (np.pi - 2 * np.pi * (np.arange(w) + 0.5) / w)[None]
    s = np.sqrt(1 - z * z)
    d = np.stack([s * np.cos(phi), s * np.sin(phi), z], -1)
    solid = (edges[:-1] - edges[1:])[:, None] * 2 * np.pi / w
    return (image * (np.maximum(d @ np.asarray(normal), 0) * solid)[..., None]).sum((0, 1))


@pytest.mark.parametrize("normal", [UP, tuple(TILT), (1.0, 0.0, 0.0)])
def test_equirectangular_world_by_quadrature(normal):
    e = lit(world=sky(), quad=(AWAY,))([[0, 0, 1]], normal=normal, samples=4096)
    assert np.allclose(e[0], world_quadrature(sky(), normal), rtol=5e-3)


def test_triangle_by_lamberts_formula():
    """The irradiance of a polygon of constant radiance is a sum over its edges (Lambert 1760)."""
    emissive = dict(quad=(RECEIVER, EMISSIVE_QUAD), material=[0, 1], surfaces=((0.5, 0), (0, 10.0)))
    for p in (np.array([0.1, -0.2, 0.05]), np.array([0.28, 0.1, 0.25]), np.array([2.0, 3, 0.1])):
        q = np.array(EMISSIVE_QUAD) - p
        total = 0.0
        for corners in (q[[0, 1, 2]], q[[0, 2, 3]]):
            unit = corners / np.linalg.norm(corners, axis=1, keepdims=True)
            one = sum(
                math.acos(np.clip(unit[i] @ unit[(i + 1) % 3], -1, 1))
                * (np.cross(corners[i], corners[(i + 1) % 3]) / np.linalg.norm(np.cross(corners[i], corners[(i + 1) % 3])))
                for i in range(3)
            )  # fmt: skip
            total += abs(one @ np.array(UP)) * 5
        assert np.allclose(lit(**emissive)([p], samples=2048)[0], total, rtol=4e-3)


# -- textured emitters -------------------------------------------------------------------------------------


def textured_scene(back_only=False):
    """A receiver under a quad whose radiance is the attribute of its corners; optionally of its back only."""
    scene = scene_of(quad=(RECEIVER, EMISSIVE_QUAD), material=[0, 1], surfaces=((0.5, 0), (0, 1.0)))
    code = [[ATTRIBUTE, 0, 0, 0, 0, 0, 0, 0]]
    code += [[BACKFACING, 1, 0, 0, 0, 0, 0, 0], [SCALE, 0, 0, 1, 0, 0, 0, 0]] if back_only else []
    code += [[EMISSION_CLOSURE, 2, 0, 0, 0, REGISTERS, 0, 0], [END] + [0] * 7]
    tables = scene.materials.tables
    flags = np.array([sc.CONSTANT, sc.EMISSIVE], np.int32)
    scene.materials.tables = tables._replace(code=np.array(code, np.int32), constants=np.ones((1, 4), np.float32), flags=flags)
    corner = np.array([[8, 1, 0], [0, 1, 0], [2, 5, 0], [0, 0, 3]], np.float32)
    scene.geometry.attributes[0, 2:, :, :3] = corner[[[0, 1, 2], [0, 2, 3]]]
    return scene


def textured_quadrature(p, n, cells=400):
    """Irradiance of `textured_scene` by midpoints over both triangles, float64."""
    total = np.zeros(3)
    q, value = np.array(EMISSIVE_QUAD), np.array([[8, 1, 0], [0, 1, 0], [2, 5, 0], [0, 0, 3.0]])
    s = (np.arange(cells) + 0.5) / cells
    a, b = np.meshgrid(s, s)
    a, b = (1 - np.sqrt(a)), np.sqrt(a) * b  # uniform on a triangle
    for corners in ([0, 1, 2], [0, 2, 3]):
        c, w = q[corners], value[corners]
        x = c[0] + a[..., None] * (c[1] - c[0]) + b[..., None] * (c[2] - c[0])
        radiance = w[0] + a[..., None] * (w[1] - w[0]) + b[..., None] * (w[2] - w[0])
        cross = np.cross(c[1] - c[0], c[2] - c[0])
        d = x - p
        r = np.linalg.norm(d, axis=-1)
        d /= r[..., None]
        g = np.maximum(d @ n, 0) * np.abs(d @ cross) / 2 / r**2
        total += (radiance * g[..., None]).mean((0, 1))
    return total


def test_textured_emitter_by_quadrature():
    light = Lit(textured_scene())
    for p in (np.array([0.1, -0.2, 0.05]), np.array([2.0, 1, 0.1]), np.array([-2, 1, 0.1])):
        assert np.allclose(light([p], samples=1024)[0], textured_quadrature(p, np.array(UP)), rtol=5e-3)


def test_emission_of_one_side_only():
    both, back = Lit(textured_scene()), Lit(textured_scene(back_only=True))
    corners = np.array(EMISSIVE_QUAD)
    cross = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    for side in (1, -1):
        n = side * cross / np.linalg.norm(cross)
        p = corners.mean(0) + 0.5 * n
        if side > 0:
            assert not back([p], normal=-n).any()
        else:
            assert np.allclose(back([p], normal=-n, samples=512), both([p], normal=-n, samples=512), rtol=0.01)


def test_dark_textured_triangles_stay_possible():
    """Triangles whose few samples were dark are drawn seldom, not never; those of dark materials not at all."""
    scene = textured_scene()
    scene.geometry.attributes[0, 3] = 0
    emitters = build_emitters(scene)
    assert len(emitters.triangle) == 2 and 0 < emitters.radiance[1].max() < 0.03 * emitters.radiance[0].max()
    scene.geometry.attributes[:] = 0
    assert len(build_emitters(scene).triangle) == 0


# -- many lamps --------------------------------------------------------------------------------------------


def many_lamps(n, seed=0):
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(n):
        position = rng.uniform([-4, -4, 0.2], [4, 4, 3])
        towards = rng.normal(size=3) - [0, 0, 1]
        emission = rng.uniform(0.1, 3) * rng.random(3)
        kind = (sc.POINT, sc.SPOT, sc.AREA)[k % 3]
        rows.append(lamp(kind, emission, position, towards, angle=1.5 if kind == sc.SPOT else math.pi, blend=0.3, size=(0.3, 0.2)))
    return rows


def test_tree_sums_to_all_lamps_one_by_one():
    rows = many_lamps(60)
    points = [[0.0, 0, 0.01], [2.5, -1, 0.3], [-3, 3, 0.01]]
    alone = sum(lit(*rows[k : k + 6])(points, samples=512) for k in range(0, 60, 6))
    all_of_them = lit(*rows)
    assert all_of_them.emitters.groups.tolist() == [-1]
    e = all_of_them(points, samples=1024, copies=64)
    noise = all_of_them.raw.reshape(3, 64, 3).std(1) / 8
    assert np.abs(e - alone).max() < 0.01 * alone.max()
    assert (np.abs(e - alone) < 5 * noise + 2e-3 * alone).all()


def test_tree_is_far_better_than_picks_by_flux():
    """At equal rays the spread of the tree's estimates is a fraction of that of picks by flux alone."""
    rows = many_lamps(300, 5)
    light = lit(*rows)
    points = np.random.default_rng(1).uniform([-3, -3, 0.05], [3, 3, 0.1], (40, 3))
    truth = light(points, samples=4096, copies=4)[:, 0]
    light(points, samples=8, copies=16)
    spread = light.raw.astype(np.float64).reshape(40, 16, 3)[:, :, 0].std(1) / truth
    power = light.emitters.flux.mean(1) / light.emitters.flux.mean()
    each = np.stack([lit(row)(points, samples=1, copies=1)[:, 0] for row in rows[:60]], 1) * len(rows) / power[:60]
    by_flux = each.std(1) / each.mean(1) / math.sqrt(8)
    assert np.median(spread) < 0.3 * np.median(by_flux)


def test_fewer_samples_than_lamps_stay_unbiased():
    rows = [lamp(sc.POINT, 1 + k, (k - 3, 0.5 * k - 1, 1 + 0.2 * k)) for k in range(7)] + [lamp(sc.SUN, 0.3)]
    light = lit(*rows, world=0.1)
    expected = light([[0, 0, 0]], samples=64)
    for samples in (1, 3):
        e = light([[0, 0, 0]], samples=samples, copies=20000)
        assert light.n_rays == 20000 * samples
        noise = light.raw.std(0) / math.sqrt(20000)
        assert (np.abs(e - expected) < 5 * noise).all()


def test_every_lamp_gets_its_ray_when_there_are_enough():
    rows = [lamp(sc.POINT, 10.0 ** (k - 2), (k - 3, 0, 2)) for k in range(5)]
    e = lit(*rows)([[0, 0, 0]], samples=5, copies=1)
    expected = sum(10.0 ** (k - 2) * 2 / ((k - 3) ** 2 + 4) ** 1.5 for k in range(5))
    assert np.allclose(e, expected, rtol=1e-5)  # points: no noise at all


def test_later_passes_continue_the_sequence():
    light = lit(AREAS["tilted"])
    exact = light([[0, 0, 0]], samples=4096)
    passes = []
    for k in range(8):
        light([[0, 0, 0]], samples=16, copies=64, first=k)
        passes.append(light.raw.astype(np.float64))
    single = np.abs(passes[0] - exact).mean()
    together = np.abs(np.mean(passes, 0) - exact).mean()
    assert together < 0.3 * single  # independent passes would reach 0.35


def test_same_bits_for_any_number_of_threads():
    light = lit(*many_lamps(20), world=sky())
    position = np.random.default_rng(0).uniform([-3, -3, 0.05], [3, 3, 1], (9000, 3)).astype(np.float32)
    n = np.tile(np.float32(UP), (9000, 1))
    points = SimpleNamespace(position=position, ns=n, ng=n, error=np.full(9000, 1e-6, np.float32))
    one, two = (direct_irradiance(light.tables, points, 4, 3, threads) for threads in (1, 4))
    assert np.array_equal(one[0], two[0]) and one[1] == two[1]


@kernel
def one_ray_each(scene, p, count, seed):
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    total = np.zeros(3)
    z = np.float32(0)
    o = np.float32(1)
    for i in range(count):
        r, g, b = direct_irradiance_at(
            scene, packet, rows, surface, p[0], p[1], p[2], np.float32(1e-6), z, z, o, z, z, o, seed, np.uint32(i), 0
        )
        total[0] += r
        total[1] += g
        total[2] += b
    return total / count


def test_single_rays_have_the_same_mean():
    emitter = [(-1, -1, 3), (1, -1, 3), (1, 1, 3), (-1, 1, 3)]
    rows = [*many_lamps(10), lamp(sc.SUN, 0.5, angle=0.2)]
    light = lit(*rows, world=sky() * np.float32(0.02), quad=(RECEIVER, emitter), material=[0, 1], surfaces=((0.5, 0), (0, 0.4)))
    p = np.float32([0.3, 0.2, 0.01])
    e = one_ray_each(light.tables, p, 200000, np.uint32(5))
    assert np.allclose(e, light([p], samples=1024, copies=64)[0], rtol=0.015)


# -- particles ---------------------------------------------------------------------------------------------


@kernel
def _emit_many(emitters, count, seed, plane, cells, half, deposit, power, hits):
    """Particles onto the square |x|, |y| < half of the plane z = plane, where nothing else is; deposit: (cells, cells, 3) W."""
    rows = new_registers(emitters.materials)
    surface = np.zeros(SURFACE, np.float32)
    for i in range(count):
        e, x, y, z, dx, dy, dz, r, g, b, near, far, before = emit(
            emitters, rows, surface, (i + 0.5) / count, sobol(i, 1, seed), sobol(i, 2, seed), sobol(i, 3, seed), sobol(i, 4, seed)
        )
        if e < 0:
            continue
        hits[e] += 1
        power[0] += r / count
        power[1] += g / count
        power[2] += b / count
        if dz >= 0 or z < plane:
            continue
        t = (plane - z) / dz
        u = (x + t * dx + half) / (2 * half) * cells
        v = (y + t * dy + half) / (2 * half) * cells
        if emitters.kind[e] == sc.SPOT and 2 * t < far < FOR_EVER:
            r, g, b = AWAY_FROM_CENTRE * r, AWAY_FROM_CENTRE * g, AWAY_FROM_CENTRE * b
        if before + near <= t <= far and 0 <= u < cells and 0 <= v < cells:
            deposit[int(v), int(u), 0] += r / count
            deposit[int(v), int(u), 1] += g / count
            deposit[int(v), int(u), 2] += b / count


def emitted(emitters, count, plane=0.0, cells=4, half=2.0, seed=7):
    """(irradiance of the cells (cells, cells, 3) W/m^2, power (3,) W, particles of each emitter)."""
    deposit, power, hits = np.zeros((cells, cells, 3)), np.zeros(3), np.zeros(max(1, len(emitters.kind)), np.int64)
    _emit_many(emitters, count, np.uint32(seed), plane, cells, half, deposit, power, hits)
    return deposit / (2 * half / cells) ** 2, power, hits


def cell_irradiance(light, cells=4, half=2.0, plane=0.0, side=24, samples=64):
    """The same means by direct light at a lattice of points in each cell."""
    n = cells * side
    s = ((np.arange(n) + 0.5) / n * 2 - 1) * half
    x, y = np.meshgrid(s, s)
    points = np.stack([x.ravel(), y.ravel(), np.full(n * n, plane)], 1)
    e = light(points, samples=samples, copies=1)
    return e.reshape(cells, side, cells, side, 3).mean((1, 3))


SENDERS = {
    "point": ([lamp(sc.POINT, (10, 5, 2), (0.5, 0.2, 1))], {}),
    "sphere": ([lamp(sc.POINT, (10, 5, 2), (0.5, 0.2, 1), radius=0.6)], {}),
    "soft": ([lamp(sc.POINT, (10, 5, 2), (0.5, 0.2, 1), radius=0.6, soft=1)], {}),
    "hard spot": ([SPOTS["hard"]], {}),
    "smooth spot": ([SPOTS["fully smooth"]], {}),
    "sphere spot": ([lamp(sc.SPOT, 10, (0.5, 0.2, 0.9), (-0.2, -0.1, -1), angle=1.6, blend=0.5, radius=0.4)], {}),
    "soft spot": ([lamp(sc.SPOT, 10, (0.5, 0.2, 0.9), (-0.2, -0.1, -1), angle=1.6, blend=0.5, radius=0.4, soft=1)], {}),
    "sun": ([lamp(sc.SUN, (3, 2, 1), towards=(0.3, 0.2, -1), angle=0.5)], {}),
    "sharp sun": ([lamp(sc.SUN, (3, 2, 1), towards=(0.3, 0.2, -1), angle=0.0)], {}),
    "rectangle": ([AREAS["tilted"]], {}),
    "ellipse": ([AREAS["ellipse"]], {}),
    "spread": ([AREAS["spread"]], {}),
    "ellipse with spread": ([AREAS["ellipse with spread"]], {}),
    "constant world": ([], dict(world=0.7)),
    "world": ([], dict(world=sky(12, 24))),
    "mesh": ([], dict(quad=(RECEIVER, EMISSIVE_QUAD), material=[0, 1], surfaces=((0.5, 0), (0, (10, 5, 2))))),
    "texture": ([], {}),
    "all": ([AREAS["tilted"], SPOTS["smooth"], lamp(sc.SUN, 0.1)], dict(world=0.1)),
}


@pytest.mark.parametrize("name", SENDERS)
def test_particles_carry_the_light_that_direct_light_finds(name):
    rows, options = SENDERS[name]
    light = lit(*rows, **options) if name != "texture" else Lit(textured_scene())
    expected = cell_irradiance(light)
    found, power, hits = emitted(light.emitters, 2**20)
    assert np.allclose(power, light.emitters.flux.sum(0), rtol=5e-3 if name != "texture" else 0.1)
    share = np.diff(light.emitters.emission_cdf)
    assert np.allclose(share, light.emitters.flux.mean(1) / light.emitters.flux.mean(1).sum())
    assert np.abs(hits - share * 2**20).max() <= 1
    assert abs(found.sum() / expected.sum() - 1) < 5e-3
    assert np.abs(found - expected).max() < 0.015 * expected.max()


@pytest.mark.parametrize(("exponent", "smoothing"), [(1, 0), (2, 0), (0, 0.5), (2, 3)])
@pytest.mark.parametrize("name", ["point", "sphere", "soft", "hard spot", "rectangle"])
def test_lamps_with_a_falloff_of_their_own(name, exponent, smoothing):
    row = SENDERS[name][0][0]
    points = [[0, 0, 0], [0.5, 0.3, 0], [-0.4, 0.7, 0]]
    plain, faded = lit(row), lit(row | {"falloff": (exponent, smoothing)})
    if name in ("point", "hard spot"):
        t = np.linalg.norm(np.array(points) - row["position"], axis=1)[:, None]
        np.testing.assert_allclose(faded(points), plain(points) * t**exponent * t**2 / (smoothing + t**2), rtol=1e-4)
    # What particles leave on the plane is what direct light finds there: the plane holds 0.5 of it.
    by_particles = trace_particles(faded.tables, 2**16, 1, seed=1)[0].flux.sum(0, dtype=np.float64)
    whole = 0.5 * cell_irradiance(faded, cells=1, half=4.0, side=200, samples=1)[0, 0] * 64
    np.testing.assert_allclose(by_particles, whole, rtol=0.02)


CUT = {
    "point": lamp(sc.POINT, (10, 5, 2), (0.3, 0.2, 0.5), radius=1.2),
    "soft": lamp(sc.POINT, (10, 5, 2), (0.3, 0.2, 0.5), radius=1.2, soft=1),
    "spot": lamp(sc.SPOT, 10, (0.3, 0.2, 0.5), (-0.2, -0.1, -1), angle=1.6, blend=0.5, radius=1.2),
    "soft spot": lamp(sc.SPOT, 10, (0.3, 0.2, 0.5), (-0.2, -0.1, -1), angle=1.6, blend=0.5, radius=1.2, soft=1),
}


@pytest.mark.parametrize("name", CUT)
def test_particles_of_lamps_that_reach_through_the_plane(name):
    # Points within a sphere see its inside, which sends particles inwards; of a spot in all directions.
    light = lit(CUT[name])
    expected = cell_irradiance(light)
    found, _, _ = emitted(light.emitters, 2**20)
    assert light.emitters.lamps[0, WITHIN] > 0.3
    assert abs(found.sum() / expected.sum() - 1) < 5e-3
    assert np.abs(found - expected).max() < 0.03 * expected.max()  # cells at a sphere's rim are half within


def test_what_lies_within_spheres():
    corners = np.array([[-9, -9, 1], [9, -9, 1], [0, 12, 1]], float)
    position, radius = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 3], [0, 0, 2]], float), np.array([0.9, 2.0, 1.9, 0.0])
    # A plane at height h cuts a disk of area pi (r^2 - h^2) out of a sphere of surface S, and meets 2 A / S of its chords.
    assert share_within(geometry(corners, [[0, 1, 2]]), position, radius) == pytest.approx([0, (4 - 1) / (2 * 4), 0, 0])
    small = geometry(1e-2 * corners + np.array([0.3, 0, 0]), [[0, 1, 2]])
    area = 0.5e-4 * 18 * 21
    assert share_within(small, position[:1], np.array([0.5])) == pytest.approx([area / (2 * np.pi * 0.25)], rel=1e-5)


@pytest.mark.parametrize("name", ["sun", "sharp sun", "constant world", "world", "all"])
def test_particles_drawn_to_a_place_carry_the_same_light(name):
    rows, options = SENDERS[name]
    land = [(-60, -60, -0.5), (60, -60, -0.5), (60, 60, -0.5), (-60, 60, -0.5)]
    light = lit(*rows, **{**options, "quad": (RECEIVER, land), "material": [0, 0]})
    places = np.random.default_rng(3).uniform((-1, -1, 0), (1, 1, 1.5), (500, 3))
    near = focused(light.emitters, places)
    assert len(near.focus) == 5
    expected = cell_irradiance(light)
    found, power, _ = emitted(near, 2**20)
    assert np.allclose(power, light.emitters.flux.sum(0), rtol=0.02)
    assert abs(found[1:3, 1:3].sum() / expected[1:3, 1:3].sum() - 1) < 0.01
    assert abs(found.sum() / expected.sum() - 1) < 0.03  # most of the outer cells lie beyond both places
    few = [[emitted(e, 2**12, seed=seed)[0][1:3, 1:3].sum() for seed in range(8)] for e in (near, light.emitters)]
    assert np.std(few[0]) < 0.3 * np.std(few[1])


def test_a_sun_over_a_wide_land_leaves_particles_to_a_lamp():
    land = [(-60, -60, -0.5), (60, -60, -0.5), (60, 60, -0.5), (-60, 60, -0.5)]
    light = lit(lamp(sc.SUN, 1, angle=0.2), lamp(sc.POINT, 1), quad=(RECEIVER, land), material=[0, 0])
    near = focused(light.emitters, np.random.default_rng(3).uniform(-1, 1, (500, 3)))
    expected = cell_irradiance(light)
    found, power, hits = emitted(near, 2**18)
    assert hits[1] > 10 * emitted(light.emitters, 2**18)[2][1]
    assert np.allclose(power, light.emitters.flux.sum(0), rtol=0.03)
    assert abs(found[1:3, 1:3].sum() / expected[1:3, 1:3].sum() - 1) < 0.01


THERE = dict(position=(20, -12, 15), towards=(-20, 11, -14))
DISTANT = {
    "point": ([lamp(sc.POINT, (10, 5, 2), THERE["position"])], {}),
    "sphere": ([lamp(sc.POINT, (10, 5, 2), THERE["position"], radius=2)], {}),
    "soft": ([lamp(sc.POINT, (10, 5, 2), THERE["position"], radius=2, soft=1)], {}),
    "spot": ([lamp(sc.SPOT, 10, **THERE, angle=1.6, blend=0.5, radius=0.4)], {}),
    "cut spot": ([lamp(sc.SPOT, 10, THERE["position"], (-20, 12, -13), angle=0.35, blend=1)], {}),
    "rectangle": ([lamp(sc.AREA, 10, **THERE, size=(2, 3))], {}),
    "spread": ([lamp(sc.AREA, 10, **THERE, size=(2, 3), shape=sc.ELLIPSE, angle=2)], {}),
    "mesh": ([], dict(quad=(RECEIVER, [(20, -12, 15), (20, -9, 16), (19, -9, 17), (19, -12, 16)]), material=[0, 1], surfaces=((0.5, 0), (0, 9)))),
}  # fmt: skip


@pytest.mark.parametrize("name", DISTANT)
def test_particles_of_lamps_far_off_are_drawn_to_a_place(name):
    rows, options = DISTANT[name]
    light = lit(*rows, **options)
    near = focused(light.emitters, np.random.default_rng(3).uniform((-1, -1, 0), (1, 1, 1.5), (500, 3)))
    expected = cell_irradiance(light)[1:3, 1:3]
    found, power, _ = emitted(near, 2**18)
    assert np.allclose(power, light.emitters.flux.sum(0), rtol=0.02)
    assert np.abs(found[1:3, 1:3] / expected - 1).max() < 0.02
    few = [[emitted(e, 2**12, seed=seed)[0][1:3, 1:3].sum() for seed in range(8)] for e in (near, light.emitters)]
    assert np.std(few[0]) < (1.5 if name == "cut spot" else 0.4) * np.std(few[1])  # whose own cone is narrow


@pytest.mark.parametrize("name", ["point", "sphere", "rectangle", "mesh"])
def test_particles_of_lamps_far_off_that_just_miss_the_place_are_no_sparks(name):
    """A sky of a mesh around a garden: the lawn beside the house was lit by what it sends all around."""
    rows, options = DISTANT[name]
    light = lit(*rows, **options)
    near = focused(light.emitters, np.random.default_rng(3).uniform(-0.1, 0.1, (500, 3)))
    assert np.allclose(emitted(near, 2**18)[0] / cell_irradiance(light), 1, atol=0.06)
    few = [[emitted(e, 2**12, seed=seed)[0].sum() for seed in range(8)] for e in (near, light.emitters)]
    assert np.std(few[0]) < 0.4 * np.std(few[1])


def test_lamps_far_off_leave_particles_to_a_near_one():
    light = lit(lamp(sc.POINT, 1e4, (200, 0, 100)), lamp(sc.POINT, 1), lamp(sc.SPOT, 1e3, (50, 0, 50), (-1, 0, -1), angle=0.1))
    near = focused(light.emitters, np.random.default_rng(3).uniform(-1, 1, (500, 3)))
    assert emitted(near, 2**12)[2].min() > 2**12 / 50
    assert emitted(near, 2**18)[0][1:3, 1:3].sum() == pytest.approx(cell_irradiance(light)[1:3, 1:3].sum(), rel=0.01)


def test_no_place_to_draw_particles_to():
    light = lit(lamp(sc.SUN, 1), world=0.1)
    everywhere = np.random.default_rng(3).uniform(*light.emitters.box, (500, 3))
    for places in (np.zeros((0, 3)), everywhere):
        assert len(focused(light.emitters, places).focus) == 0
    assert len(focused(light.emitters, np.zeros((5, 3))).focus) == 7  # a single place has boxes about it, too


@pytest.mark.parametrize("size", [60.0, 1e4])
def test_particles_that_just_miss_the_known_places_are_no_sparks(size):
    """However wide the land: they were told by one in thousands, with so much more light."""
    land = [(-size, -size, -0.5), (size, -size, -0.5), (size, size, -0.5), (-size, size, -0.5)]
    light = lit(lamp(sc.SUN, 1), quad=(RECEIVER, land), material=[0, 0])
    near = focused(light.emitters, np.random.default_rng(3).uniform((-1, -1, 0), (1, 1, 1), (500, 3)))
    for seed in range(6):
        found = emitted(near, 2**12, half=4.0, seed=seed)[0][..., 0]
        beside = found.sum() - found[1:3, 1:3].sum()  # the places are within the cells in the middle
        assert beside / 12 == pytest.approx(1, rel=0.4)


def test_total_flux():
    flux = lambda row: build_emitters(scene_of(row)).flux[0, 0]  # noqa: E731
    assert flux(lamp(sc.POINT, 10)) == pytest.approx(40 * math.pi)
    assert flux(lamp(sc.POINT, 10, radius=0.4)) == pytest.approx(40 * math.pi)
    assert flux(lamp(sc.AREA, 10, size=(2, 3))) == pytest.approx(60 * math.pi)
    assert flux(lamp(sc.AREA, 10, size=(2, 3), shape=sc.ELLIPSE)) == pytest.approx(15 * math.pi**2)
    assert flux(lamp(sc.SPOT, 10, angle=1.0)) == pytest.approx(20 * math.pi * (1 - math.cos(0.5)), rel=1e-5)
    c = np.linspace(math.cos(0.6), 1, 200001)
    smooth = 20 * math.pi * spot_attenuation(c, 1.2, 0.7).mean() * (1 - c[0])
    assert flux(lamp(sc.SPOT, 10, angle=1.2, blend=0.7)) == pytest.approx(smooth, rel=1e-4)
    a = math.radians(35)
    t = np.linspace(0, a, 200001)
    spread = 2 * math.pi * (np.cos(t) * np.sin(t) * (1 - np.tan(t) / math.tan(a))).mean() * a
    assert flux(lamp(sc.AREA, 10, size=(2, 3), angle=2 * a)) == pytest.approx(60 * spread, rel=1e-4)


@kernel
def _sample_many(emitters, e, p, n, count, seed, out):
    rows = new_registers(emitters.materials)
    surface = np.zeros(SURFACE, np.float32)
    for i in range(count):
        s = sample_emitter(emitters, e, p[0], p[1], p[2], n[0], n[1], n[2], sobol(i, 0, seed), sobol(i, 1, seed), rows, surface)
        for k in range(7):
            out[i, k] = s[k]


@pytest.mark.parametrize("name", ["sphere", "sphere spot", "rectangle", "ellipse", "mesh", "sun", "world"])
def test_samples_lie_on_the_emitter(name):
    rows, options = SENDERS[name]
    emitters = build_emitters(scene_of(*rows, **options))
    p, n = np.float32([0.1, -0.2, 0.05]), np.float32(UP)
    out = np.zeros((4096, 7), np.float32)
    _sample_many(emitters, 0, p, n, 4096, np.uint32(1), out)
    d, t = out[:, :3].astype(np.float64), out[:, 3].astype(np.float64)
    assert np.abs((d**2).sum(1) - 1).max() < 1e-5
    if name in ("sun", "world"):
        assert np.isinf(t).all()
        return
    q = p + d * t[:, None]
    if name in ("sphere", "sphere spot"):
        c, r = np.array(rows[0]["position"]), rows[0]["radius"]
        assert np.abs(np.linalg.norm(q - c, axis=1) - r).max() < 1e-4
        assert (((q - c) * d).sum(1) < 1e-4).all()  # the near side
    elif name == "mesh":
        a, b, c = emitters.shapes[0, :9].reshape(3, 3).astype(np.float64)
        w = np.linalg.lstsq(np.stack([b - a, c - a], 1), (q - a).T, rcond=None)[0]
        assert w.min() > -1e-4 and w.sum(0).max() < 1 + 1e-4
        assert np.abs((q - a) @ emitters.shapes[0, 9:12].astype(np.float64)).max() < 1e-5
    else:
        inside = out[:, 4] > 0
        local = (q - np.array(rows[0]["position"])) @ rows[0]["axes"].T
        assert np.abs(local[:, 2]).max() < 1e-5
        u, v = (np.abs(local[inside, :2]) / np.array(rows[0]["size"]) * 2).T
        assert (u * u + v * v).max() < 1 + 1e-4 if name == "ellipse" else max(u.max(), v.max()) < 1 + 1e-4


def test_lamps_reach_all_places_of_a_point():
    """The cone of a spot holds half of a pixel's places, but not its first: alone, and in a tree of many."""
    spots = [lamp(sc.SPOT, 10.0, (0.3 + 3 * k, 0, 1), angle=0.2) for k in range(40)]
    for rows in (spots[:1], spots):
        light = lit(*rows, quad=([(-200, -4, 0), (200, -4, 0), (200, 4, 0), (-200, 4, 0)],))
        n = 256
        up = np.tile(np.float32(UP), (n, 1))
        points = SimpleNamespace(position=np.zeros((n, 3), np.float32), ns=up, ng=up, error=np.full(n, 1e-6, np.float32))
        points.spread = np.zeros((n, 3, 3), np.float32)
        points.spread[:, 1:, 0] = 0.3
        found, _ = direct_irradiance(light.tables, points, 8, 1)
        assert found.mean() == pytest.approx(5.0, rel=0.01)
