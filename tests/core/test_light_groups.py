"""Light groups: layers that add up, and each of which is the light of its own lamps."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.denoise import Denoiser
from lumigate.core.group_shares import shares_of
from lumigate.core.lamps import LightGroups
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.core.surfaces.layout import EMISSION

KINDS = ("Combined", "Direct", "Indirect")
KEY, FILL, SHINE, DARK, REST = "key", "fill", "a shining_thing", "dark", "Remainder"
QUICK = RenderSettings(vpls=512, pixel_samples=2)


def point_lamps(*rows):
    """(position, intensity, group) each."""
    n, f = len(rows), np.float32
    position, emission, groups = zip(*rows)
    return sc.Lamps(
        np.full(n, sc.POINT, np.int32), np.array(position, f), np.broadcast_to(np.eye(3, dtype=f), (n, 3, 3)).copy(),
        np.array(emission, f), np.full(n, 0.02, f), np.zeros(n, np.uint8), np.zeros(n, f), np.zeros(n, f), np.zeros((n, 2), f),
        np.zeros(n, np.int32), np.full(n, sc.ALL_RAYS & ~sc.CAMERA, np.uint8), np.ones(n, np.uint8), [f"lamp {k}" for k in range(n)], list(groups),
    )  # fmt: skip


@pytest.fixture(scope="module")
def room(build):
    """A glossy room without a ceiling: two lamps, one of them without a group, a quad that shines, and the sky."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    walls = [[corners[k] for k in face] for face in [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4)]]
    shining = [(-0.9, -0.3, -0.9), (-0.9, 0.3, -0.9), (-0.9, 0.3, -0.3), (-0.9, -0.3, -0.3)]
    soup = build.geometry(*build.quads(*walls, shining[::-1]), material=np.repeat([0, 1], [10, 2]))
    soup.object[10:] = 1
    soup.object_names, soup.object_visibility = ["room", "quad"], np.full(2, sc.ALL_RAYS, np.uint8)
    soup.object_groups = ["", SHINE]
    lamps = point_lamps(((0.5, 0.2, 0.3), (1, 0.5, 0.2), KEY), ((-0.4, -0.6, 0.1), (0.1, 0.3, 0.9), "not in the view layer"))
    stuff = build.glossy_materials((0.6, 0.0), (0.0, 2.0), albedo=0.1, roughness=0.3)
    scene = build.scene(soup, stuff, lamps=lamps, world=(0.1, 0.2, 0.3), camera=build.camera(width=32, height=32, position=(0, 0, 2)))
    scene.world.group = FILL
    return replace(scene, light_groups=(KEY, FILL, SHINE, DARK))


def of_group(scene, name):
    """The scene with only the group's lamps on."""
    lamps = scene.lamps.take(np.array([(g if g == KEY else REST) == name for g in scene.lamps.groups]))
    world = replace(scene.world, radiance=scene.world.radiance * (name == FILL))
    tables = scene.materials.tables
    constant = tables.constant.copy()
    if name != SHINE:
        constant[1, EMISSION : EMISSION + 3] = 0
    flags = tables.flags if name == SHINE else tables.flags & ~sc.EMISSIVE
    materials = replace(scene.materials, tables=tables._replace(constant=constant, flags=flags))
    return replace(scene, lamps=lamps, world=world, materials=materials, light_groups=())


@pytest.mark.parametrize("denoise", [True, False])
def test_the_layers_of_groups_add_up_to_the_whole(room, denoise):
    layers = render(room, replace(QUICK, denoise=denoise)).layers
    for kind in KINDS:
        parts = {name: layers[f"{kind}_{name}"] for name in (KEY, FILL, SHINE, DARK, REST)}
        np.testing.assert_allclose(sum(parts.values()), layers[kind], rtol=1e-4, atol=1e-5 * layers[kind].mean())
        assert not parts.pop(DARK).any()
        assert all(part.any() and part.min() >= 0 for part in parts.values())


def test_they_add_up_where_there_is_no_time_to_light_all_pixels(room, no_time):
    wide = replace(room, camera=replace(room.camera, width=64, height=64, border=(0, 0, 64, 64)))
    result = render(wide, replace(QUICK, time_budget=0.2))
    assert result.stats["auto"]["lit"]
    for kind in KINDS:
        parts = {name: result.layers[f"{kind}_{name}"] for name in (KEY, FILL, SHINE, DARK, REST)}
        whole = result.layers[kind]
        np.testing.assert_allclose(sum(parts.values()), whole, rtol=1e-3, atol=1e-4 * whole.mean())
        assert not parts.pop(DARK).any()
        assert all(part.any() for part in parts.values())


def test_groups_leave_the_whole_as_it_is(room):
    with_groups, without = (render(room, replace(QUICK, light_groups=on)).layers for on in (True, False))
    assert not [name for name in without if "_" in name]
    for name in without:
        # A path's end may hang on a rounding error.
        assert np.abs(with_groups[name] - without[name]).mean() <= 2e-3 * np.abs(without[name]).mean(), name


def test_a_group_is_the_light_of_its_lamps_alone(room):
    raw = replace(QUICK, denoise=False)
    layers = [render(room, replace(raw, seed=seed)).layers for seed in range(4)]
    for name in (KEY, FILL, SHINE, REST):
        alone = [render(of_group(room, name), replace(raw, seed=seed)).layers for seed in range(4, 8)]
        for kind in KINDS:
            got, expected = (np.mean([images[n].mean() for images in runs]) for runs, n in ((layers, f"{kind}_{name}"), (alone, kind)))
            assert got == pytest.approx(expected, rel=0.05), (name, kind)


def test_other_methods_say_that_they_tell_nothing_apart(room):
    result = render(room, replace(QUICK, method="instant-radiosity", vpls=32, pixel_samples=1))
    assert not [name for name in result.layers if "_" in name]
    assert any("light groups" in warning for warning in result.stats["warnings"])


def test_what_is_in_no_group_of_the_view_layer_is_in_the_remainder(room):
    groups = LightGroups.of(room)
    assert groups.names == (KEY, FILL, SHINE, REST) and groups.dark == (DARK,)
    assert groups.lamps.tolist() == [0, 3] and groups.world == 1 and groups.objects[1] == 2
    assert LightGroups.of(replace(room, light_groups=())).names == ("",)
    # A group of that very name takes them in.
    assert LightGroups.of(replace(room, light_groups=(KEY, REST))).names == (KEY, REST)


def test_shares_of_noisy_groups():
    """Two groups in noise on a grey wall, one of which is shadowed on the right half; the third gives nothing."""
    rng = np.random.default_rng(1)
    shape = (48, 64, 3)
    true = np.zeros((3, *shape), np.float32)
    true[0], true[1, :, :32] = (0.2, 0.4, 0.8), (0.9, 0.5, 0.1)
    noisy = true * rng.gamma(4, 0.25, (3, *shape[:2], 1)).astype(np.float32)
    wall = np.full(shape, 0.5, np.float32)
    normal = np.broadcast_to(np.float32((0, 0, 1)), shape)
    with_denoiser = Denoiser(quality="fast")
    found = shares_of(noisy, true.sum(axis=0), wall, normal, np.zeros(shape, np.float32), with_denoiser)
    with_denoiser.close()
    np.testing.assert_allclose(found.sum(axis=0), true.sum(axis=0), rtol=1e-5)
    assert not found[2].any()

    def error(images):
        return ((images - true) ** 2).mean()

    assert error(found) < 0.1 * error(noisy)


def test_shares_where_nothing_shines():
    nothing = np.zeros((2, 8, 8, 3), np.float32)
    guides = [nothing[0]] * 3
    assert not shares_of(nothing, nothing[0], *guides, Denoiser(quality="fast")).any()
    # What the denoiser of the whole has put where nothing was belongs to somebody.
    np.testing.assert_array_equal(shares_of(nothing, nothing[0] + 1, *guides, Denoiser(quality="fast")).sum(axis=0), nothing[0] + 1)
