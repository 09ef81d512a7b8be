"""Diffuse transmission: what a translucent surface sends is what arrives on its other side, for every kind of path."""

import math

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.lightmaps.bake import Target, bake
from lumigate.core.pipeline import render
from lumigate.core.settings import BakeSettings, RenderSettings
from lumigate.core.surfaces.layout import GLOSSY_F0, GLOSSY_F90, ROUGHNESS, TRANSLUCENCY

SHEET = [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)]
COLOR = np.array([0.5, 0.4, 0.1])  # transmittance
DEPTH = 2.0  # of the lamp below the sheet (m)
INTENSITY = 3.0  # W/sr


SEEDS = (1, 2, 3, 4)


def layers_of(scene, seed=3, **settings):
    return render(scene, RenderSettings(denoise=False, seed=seed, **settings)).layers


def sheet_over_lamp(build, albedo=0.2, height=2.0):
    """A sheet seen from above, its front, or below by the sign of the camera's height; the lamp is on the other side."""
    stuff = build.translucent_materials((albedo, 0.0), transmittance=[COLOR])
    lamp = build.lamp(sc.POINT, INTENSITY, position=(0, 0, -DEPTH if height > 0 else DEPTH))
    view = build.camera(position=(0.5, 0, height), width=8, height=8, angle=0.1)
    if height < 0:
        view.matrix[:3, :3] = np.diag([1.0, -1.0, -1.0])
    return build.scene(build.geometry(*build.quads(SHEET)), stuff, lamps=lamp, camera=view)


@pytest.mark.parametrize("height", [2.0, -2.0])
def test_a_sheet_shows_the_irradiance_of_its_other_side(build, height):
    layers = layers_of(sheet_over_lamp(build, height=height), pixel_samples=2, bounces=0)
    x, y = layers["Position"][..., 0].astype(float), layers["Position"][..., 1].astype(float)
    irradiance = INTENSITY * DEPTH / (DEPTH**2 + x**2 + y**2) ** 1.5
    expected = COLOR / math.pi * irradiance[..., None]
    np.testing.assert_allclose(layers["Direct"], expected, rtol=0.01)  # at the place of the nearest sample
    np.testing.assert_allclose(layers["Direct"].mean((0, 1), dtype=float), expected.mean((0, 1)), rtol=1e-3)
    np.testing.assert_allclose(layers["Albedo"], np.broadcast_to(0.2 + COLOR, (8, 8, 3)), rtol=1e-5)


def test_what_is_not_translucent_hides_the_lamp(build):
    scene = sheet_over_lamp(build)
    scene.materials.tables.constant[:, TRANSLUCENCY : TRANSLUCENCY + 3] = 0
    assert not layers_of(scene, bounces=0)["Direct"].any()


def test_a_mirror_shows_light_that_comes_through(build):
    """The floor is a mirror; above the camera there is the sheet, which a sun lights from above."""
    low = [(x, y, -1) for x, y, _ in SHEET]
    stuff = build.translucent_materials((0.0, 0.0), (0.0, 0.0), transmittance=[COLOR, 0.0])
    stuff.tables.constant[1, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[1, GLOSSY_F90 : GLOSSY_F90 + 3] = 0.8
    stuff.tables.flags[1] |= sc.GLOSSY_LOBE
    stuff.tables.constant[1, ROUGHNESS] = 0.05
    sun = build.lamp(sc.SUN, 2.0, angle=0.01)
    scene = build.scene(
        build.geometry(*build.quads(SHEET, low), material=[0, 0, 1, 1]), stuff, lamps=sun,
        camera=build.camera(position=(0, 0, -0.5), angle=0.6),
    )  # fmt: skip
    for bounces in (1, 3):
        layers = layers_of(scene, bounces=bounces, reflections=16, pixel_samples=4)
        shown = layers["GlossyIndirect"].mean((0, 1), dtype=float)
        np.testing.assert_allclose(shown, 0.8 * COLOR * 2.0 / math.pi, rtol=0.03)
        assert not layers["Direct"].any()


# -- a lamp within a translucent ball within a ball: by symmetry irradiance is the same everywhere -------------

ALBEDO, THROUGH, WALL = 0.3, 0.5, 0.7


def area(vertices, triangles):
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.fixture(scope="module")
def balls(build):
    """The scene, and its irradiance by bounces (1..9, 3): of the inner ball's inside and outside, and the outer one's."""
    inner, outer = build.icosphere(2, 1.0), build.icosphere(2, 2.0)
    stuff = build.translucent_materials((ALBEDO, 0.0), (WALL, 0.0), transmittance=[THROUGH, 0.0])
    vertices, triangles, material = build.join((*inner, 0), (*outer, 1))
    lamp = build.lamp(sc.POINT, INTENSITY)
    view = build.camera(position=(0, 0, 1.6), angle=1.9)
    scene = build.scene(build.geometry(vertices, triangles, material), stuff, lamps=lamp, camera=view)
    # A surface's radiosity is what it reflects of the last bounce, and what comes through of this one.
    part = area(*inner) / area(*outer)
    arrives = np.array([[1, 0, 0], [0, 0, 1], [0, part, 1 - part]])  # irradiance by radiosity
    reflects = np.diag([ALBEDO, ALBEDO, WALL])
    passes = np.array([[0, THROUGH, 0], [THROUGH, 0, 0], [0, 0, 0]])
    direct = np.array([4 * math.pi * INTENSITY / area(*inner), 0, 0])
    light, found = (reflects + passes) @ direct, []
    solve = np.linalg.inv(np.eye(3) - passes @ arrives)
    for _ in range(9):
        light = solve @ light
        found.append(arrives @ light)
        light = reflects @ arrives @ light
    return scene, direct, np.cumsum(found, axis=0)


@pytest.mark.parametrize(
    ("method", "more", "bound"),
    [
        ("importance-sampling", 1, 0.03),
        ("instant-radiosity", 0, 0.05),
        ("fuzzy-clustering", 0, 0.08),
        ("virtual-area-lights", 0, 0.4),  # its soft maps see through a sheet in part
        ("visibility-gates", 0, 0.06),
    ],
)
@pytest.mark.parametrize("bounces", [1, 8])
def test_light_leaves_a_translucent_ball(balls, method, more, bound, bounces):
    """more: bounces of light that comes through to the eye, which Cycles does not count."""
    scene, direct, indirect = balls
    shown = [layers_of(scene, seed, bounces=bounces, vpls=2048, pixel_samples=4, direct_samples=8, method=method) for seed in SEEDS]
    layers = {name: np.mean([one[name] for one in shown], axis=0) for name in ("Position", "DiffuseIndirect", "Direct")}
    # Pixels at the ball's edge, 39 degrees off the axis, show both.
    away = layers["Position"] - (0, 0, 1.6)
    angle = np.degrees(np.arccos(-away[..., 2] / np.linalg.norm(away, axis=2)))
    ball, walls = angle < 30, angle > 46
    assert ball.sum() >= 16 and walls.sum() >= 100
    inside, outside, wall = indirect[bounces - 1]
    inside = indirect[bounces - 1 + more][0]
    found = layers["DiffuseIndirect"].mean(axis=2, dtype=float)
    assert found[ball].mean() == pytest.approx((ALBEDO * outside + THROUGH * inside) / math.pi, rel=bound)
    assert found[walls].mean() == pytest.approx(WALL * wall / math.pi, rel=bound)
    assert layers["Direct"][ball].mean(dtype=float) == pytest.approx(THROUGH * direct[0] / math.pi, rel=0.02)
    assert not layers["Direct"][walls].any()


def test_light_leaves_a_shade_of_two_sheets(build):
    """Of a ball within a ball, which both are translucent, a centimetre apart and turned out to either side, as of a solidified sheet."""
    shells = [build.icosphere(2, radius) for radius in (0.5, 0.51, 2.0)]
    shells[0] = shells[0][0], np.ascontiguousarray(shells[0][1][:, ::-1])
    stuff = build.translucent_materials((ALBEDO, 0.0), (WALL, 0.0), transmittance=[THROUGH, 0.0])
    vertices, triangles, material = build.join(*((*shell, number) for shell, number in zip(shells, (0, 0, 1))))
    scene = build.scene(
        build.geometry(vertices, triangles, material), stuff, lamps=build.lamp(sc.POINT, INTENSITY), camera=build.camera(position=(0, 0, 1.6), angle=1.9)
    )  # fmt: skip
    # Inner ball's inside and outside, outer ball's inside and outside, wall: irradiance by radiosity.
    within, between = (area(*shells[k]) / area(*shells[k + 1]) for k in (0, 1))
    arrives = np.zeros((5, 5))
    arrives[0, 0] = arrives[1, 2] = arrives[3, 4] = 1
    arrives[2, 1:3] = within, 1 - within
    arrives[4, 3:5] = between, 1 - between
    passes = np.zeros((5, 5))
    passes[[0, 1, 2, 3], [1, 0, 3, 2]] = THROUGH
    solve, reflects = np.linalg.inv(np.eye(5) - passes @ arrives), np.diag([ALBEDO] * 4 + [WALL])
    radiosity = solve @ (reflects + passes) @ np.array([4 * math.pi * INTENSITY / area(*shells[0]), 0, 0, 0, 0])
    wall = 0.0
    for _ in range(4):
        wall += (arrives @ radiosity)[4]
        radiosity = solve @ reflects @ arrives @ radiosity
    shown = [layers_of(scene, seed, bounces=4, vpls=2048, pixel_samples=4, method="importance-sampling") for seed in SEEDS]
    away = np.mean([one["Position"] for one in shown], axis=0) - (0, 0, 1.6)
    walls = np.degrees(np.arccos(-away[..., 2] / np.linalg.norm(away, axis=2))) > 26  # the ball's edge is at 19 degrees
    found = np.array([one["DiffuseIndirect"][walls].mean(dtype=float) for one in shown])
    # Few paths get between the sheets: with sixteen times as many it is right within 2 %.
    assert found.mean() == pytest.approx(WALL * wall / math.pi, rel=0.15)
    assert found.std() < 0.04 * found.mean()


def test_a_lightmap_holds_what_the_whole_colour_makes_the_light(build):
    """Lit from behind, the texels of a sheet hold the transmitted part; the colour times that is what the sheet sends."""
    scene = sheet_over_lamp(build)
    sun = build.lamp(sc.SUN, 2.0, axes=np.diag([1.0, -1.0, -1.0]), angle=0.01)  # from below
    scene.lamps, scene.camera = sun, None
    uv = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)[[[0, 1, 2], [0, 2, 3]]]
    target = Target("Sheet", np.arange(2, dtype=np.int32), uv, (8, 8))
    request = RenderSettings(denoise=False, bounces=1, vpls=64)
    share = COLOR / (COLOR + 0.2)
    for content, value in {"irradiance": 2.0 * share, "full": 2.0 * COLOR / math.pi}.items():
        image = bake(scene, [target], BakeSettings(request, content=content)).lightmaps[0].image
        np.testing.assert_allclose(image, np.broadcast_to(value, (8, 8, 3)), rtol=1e-3)
