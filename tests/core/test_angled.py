"""Materials whose nodes ask for the side or the angle of a view: each ray sees them as it meets them."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.lamps import build_emitters
from lumigate.core.lamps.direct import direct_irradiance
from lumigate.core.lamps.world import pixel_directions
from lumigate.core.particles import trace_particles
from lumigate.core.rays import RayScene
from lumigate.core.surfaces import layout
from lumigate.core.surfaces import program as ops
from lumigate.core.surfaces.visibility import OUTSIDE, evaluate_along
from lumigate.core.transport import transport
from lumigate.core.view.mirrors import with_mirrors

F = np.float32
R = ops.REGISTERS
SHEET = [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)]
IOR = 1.45
SIDED = [(ops.BACKFACING, 0, R, R, R, R, R, 0)]
FRESNEL = [(ops.FRESNEL, 0, R + 2, R, R, R, R, 0)]
SHADOW_RAY = [(ops.VIEWED, 0, R, R, R, R, R, sc.SHADOW)]
FACING = [(ops.FACING, 0, R + 1, R, R, R, R, 0)]


def angled(build, instructions, closure, flags):
    """A material of one closure, whose colour is row 0."""
    code = [[ops.END, *[0] * 7], *map(list, instructions), [closure, 1, 0, R + 3, R, R + 1, R, 0], [ops.END, *[0] * 7]]
    stuff = build.materials((0.0, 0.0))
    stuff.tables.start[0], stuff.tables.flags[0] = 1, sc.ANGLED | flags
    constants = np.array([[0, 0, 0, 1], [1, 1, 1, 1], [IOR, IOR, IOR, 1], [0.05, 0.05, 0.05, 1]], F)
    return sc.Materials(stuff.names, stuff.tables._replace(code=np.array(code, np.int32), constants=constants))


def scene_of(build, materials, lamp=None):
    return build.scene(build.geometry(*build.quads(SHEET)), materials, lamps=lamp)


def fresnel(cosine, ior):
    """Fresnel's equations, of light that comes from outside of `ior`."""
    sine = np.sqrt(1 - cosine * cosine) / ior
    beyond = np.sqrt(np.maximum(0, 1 - sine * sine))
    across, along = (cosine - ior * beyond) / (cosine + ior * beyond), (beyond - ior * cosine) / (beyond + ior * cosine)
    return np.where(sine >= 1, 1.0, 0.5 * (across * across + along * along))


EXPECTED = {
    "sided": (SIDED, lambda down, cosine: 0.0 if down else 1.0),
    "fresnel": (FRESNEL, lambda down, cosine: fresnel(np.float64(cosine), IOR if down else 1 / IOR)),
    "facing": (FACING, lambda down, cosine: 1 - cosine),
}


@pytest.mark.parametrize("name", EXPECTED)
@pytest.mark.parametrize("cosine", [0.2, 0.6, 0.9])
@pytest.mark.parametrize("down", [True, False])
def test_each_ray_sees_its_side_and_angle(build, name, cosine, down):
    instructions, expected = EXPECTED[name]
    scene = scene_of(build, angled(build, instructions, ops.TRANSPARENT_CLOSURE, sc.TRANSPARENT))
    rows, surface = ops.new_registers(scene.materials.tables), np.zeros(layout.SURFACE, F)
    d = 3.0 * np.array([math.sqrt(1 - cosine**2), 0, -cosine if down else cosine])  # of any length
    with RayScene(scene.geometry.vertices, scene.geometry.triangles) as rays:
        tables = transport(scene.geometry, scene.materials.tables, rays.tables, build_emitters(scene))
        evaluate_along(tables, np.int32(0), F(0.2), F(0.3), *map(F, d), sc.DIFFUSE, OUTSIDE, rows, surface)
    np.testing.assert_allclose(surface[layout.TRANSPARENCY : layout.TRANSPARENCY + 3], expected(down, cosine), atol=1e-4)


@pytest.mark.parametrize("lamp_above", [True, False])
def test_particles_pass_what_is_seen_through_from_the_other_end(build, lamp_above):
    """The sheet's back is clear, its front is not, and a floor lies on either side."""
    materials = angled(build, SIDED, ops.TRANSPARENT_CLOSURE, sc.TRANSPARENT)
    white = build.materials((0.0, 0.0), (0.8, 0.0)).tables
    tables = materials.tables._replace(
        start=np.array([1, 0], np.int32), flags=np.array([materials.tables.flags[0], sc.CONSTANT], np.int32), constant=white.constant
    )
    height = -1 if lamp_above else 1
    floor = [(20 * x, 20 * y, height) for x, y, _ in SHEET]
    geometry = build.geometry(*build.quads(SHEET, floor), material=np.array([0, 0, 1, 1], np.int32))
    lamp = build.lamp(sc.POINT, 1.0, position=(0, 0, -0.1 * height))
    scene = build.scene(geometry, sc.Materials(["sheet", "floor"], tables), lamps=lamp)
    with RayScene(geometry.vertices, geometry.triangles, transparent=geometry.material == 0) as rays:
        vpls, _ = trace_particles(transport(geometry, tables, rays.tables, build_emitters(scene)), 2000, 1, seed=1, threads=1)
    # A point on the lower floor looks up at the sheet's back; one on the upper floor looks down at its front.
    assert (len(vpls.flux) > 500) == lamp_above


@pytest.mark.parametrize("name", EXPECTED)
@pytest.mark.parametrize("down", [True, False])
def test_lights_have_the_mean_of_what_their_side_sends(build, name, down):
    instructions, expected = EXPECTED[name]
    materials = angled(build, instructions, ops.DIFFUSE_CLOSURE, 0)
    lamp = build.lamp(sc.POINT, 1.0, position=(0, 0, 1e-2 if down else -1e-2))
    scene = scene_of(build, materials, lamp)
    with RayScene(scene.geometry.vertices, scene.geometry.triangles) as rays:
        tables = transport(scene.geometry, materials.tables, rays.tables, build_emitters(scene))
        vpls, _ = trace_particles(tables, 20_000, 1, seed=1, threads=1)
    cosine = np.sqrt((np.arange(10_000) + 0.5) / 10_000)
    mean = np.mean([expected(down, c) for c in cosine])
    sent = build_emitters(scene).flux[0, 0] / 2  # half of it meets the sheet
    assert vpls.flux[:, 0].sum(dtype=float) == pytest.approx(mean * sent, rel=0.02, abs=1e-6)


def test_lamps_shine_through_what_shadow_rays_alone_pass(build):
    """A sheet between a lamp and a floor: the lamp lights the floor, whose light is kept from a ceiling above the sheet."""
    materials = angled(build, SHADOW_RAY, ops.TRANSPARENT_CLOSURE, sc.TRANSPARENT)
    white = build.materials((0.0, 0.0), (0.8, 0.0)).tables
    tables = materials.tables._replace(
        start=np.array([1, 0], np.int32), flags=np.array([materials.tables.flags[0], sc.CONSTANT], np.int32), constant=white.constant
    )
    floor, ceiling = ([(20 * x, 20 * y, z) for x, y, _ in corners] for z, corners in ((-1, SHEET), (2, SHEET[::-1])))
    geometry = build.geometry(
        *build.quads([(20 * x, 20 * y, 0) for x, y, _ in SHEET], floor, ceiling), material=np.array([0, 0, 1, 1, 1, 1], np.int32)
    )
    lamp = build.lamp(sc.POINT, 1.0, position=(0, 0, 1))
    emitters = build_emitters(build.scene(geometry, sc.Materials(["sheet", "walls"], tables), lamps=lamp))
    with RayScene(geometry.vertices, geometry.triangles, transparent=geometry.material == 0) as rays:
        ready = transport(geometry, tables, rays.tables, emitters)
        vpls, _ = trace_particles(ready, 4000, 2, seed=1, threads=1)
        up = np.array([[0, 0, 1]], np.float32)
        point = SimpleNamespace(position=np.array([[0, 0, -1]], np.float32), ns=up, ng=up, error=np.full(1, 1e-6, np.float32))
        light, _ = direct_irradiance(ready, point, 4, seed=1)
    np.testing.assert_allclose(light, 1 / 2**2, rtol=0.01)  # W/m^2, 2 m below the lamp
    z = vpls.position[:, 2]
    # Half of the lamp's light falls on either, and stays on that side of the sheet.
    assert vpls.flux[z < -0.5].sum() == pytest.approx(vpls.flux[z > 1.5].sum(), rel=0.05)


def test_of_an_uneven_sky_shadow_rays_have_their_share(build):
    """What Cycles finds of it by rays that a diffuse surface scatters does not pass a sheet that shadow rays alone pass."""
    height, width = 16, 32
    d, solid_angle = pixel_directions(height, width)
    sky = (0.2 + 3 * np.maximum(0, d @ np.array([0.6, 0, 0.8])) ** 8)[..., None] * np.ones(3)
    materials = angled(build, SHADOW_RAY, ops.TRANSPARENT_CLOSURE, sc.TRANSPARENT | sc.TELLING)
    geometry = build.geometry(*build.quads([(200 * x, 200 * y, 0) for x, y, _ in SHEET]))
    emitters = build_emitters(build.scene(geometry, materials, world=sky))
    with RayScene(geometry.vertices, geometry.triangles, transparent=geometry.material == 0) as rays:
        ready = transport(geometry, materials.tables, rays.tables, emitters)
        up = np.tile(F([0, 0, 1]), (64, 1))
        points = SimpleNamespace(position=-up, ns=up, ng=up, error=np.full(64, 1e-6, F))
        light, _ = direct_irradiance(ready, points, 256, seed=1)
    shines, cosine = sky[..., 0], np.maximum(0, d[..., 2])
    aimed = shines / (shines * solid_angle).sum()
    share = aimed**2 / (aimed**2 + (cosine / math.pi) ** 2)
    expected = (share * shines * cosine * solid_angle).sum()
    assert 0.2 < expected / (shines * cosine * solid_angle).sum() < 0.8
    assert light.mean() == pytest.approx(expected, rel=0.03)


def test_a_material_that_mirrors_on_its_back_alone_is_asked(build):
    materials = angled(build, SIDED, ops.GLOSSY_CLOSURE, sc.GLOSSY_LOBE)
    scene = scene_of(build, materials)
    assert (with_mirrors(materials.tables, scene.geometry).flags & sc.MIRRORING).all()
