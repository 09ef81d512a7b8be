"""What the frames of a sequence share: nothing is computed twice, and no frame sees what is not there."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import rays
from lumigate.core import scene as sc
from lumigate.core.picture import Picture
from lumigate.core.pipeline import remember, render, scout
from lumigate.core.reuse import Sequence
from lumigate.core.reuse.history import Estimate, reproject, trust
from lumigate.core.settings import RenderSettings, SequenceSettings
from lumigate.core.surfaces.layout import GLOSSY_F0, GLOSSY_F90

SETTINGS = RenderSettings(method="importance-sampling", vpls=64, samples=2, gather=2, pixel_samples=4, direct_samples=1, denoise=False)
SIZE = 24


@pytest.fixture
def room(build):
    """A box with a shining ceiling and a block in it; objects: 0 the box, 1 the block."""
    s = 2.0
    corners = np.array([(x, y, z) for x in (-s, s) for y in (-s, s) for z in (-s, s)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    walls = [corners[list(face)] for face in faces]
    block = [0.5 * wall[::-1] + np.array([0, -1.0, -1.0]) for wall in walls]
    geometry = build.geometry(*build.quads(*walls, *block))
    geometry.object[12:] = 1
    geometry.object_names, geometry.object_visibility = ["box", "block"], np.full(2, 31, np.uint8)
    geometry.material[6:8] = 1  # the wall at +y shines
    camera = build.camera((0, 0, 1.9), SIZE, SIZE)
    return build.scene(geometry, build.materials((0.6, 0), (0.3, 3)), camera=camera)


def polished(scene):
    """The same with walls that mirror."""
    tables = scene.materials.tables
    tables = tables._replace(flags=tables.flags | sc.GLOSSY_LOBE, constant=tables.constant.copy())
    tables.constant[0, GLOSSY_F0 : GLOSSY_F90 + 3] = 0.9
    return replace(scene, materials=replace(scene.materials, tables=tables))


def moved_camera(scene, offset):
    matrix = scene.camera.matrix.copy()
    matrix[:3, 3] += offset
    return replace(scene, camera=replace(scene.camera, matrix=matrix))


def moved_block(scene, offset):
    vertices = scene.geometry.vertices.copy()
    vertices[24:] += np.float32(offset)
    return replace(scene, geometry=replace(scene.geometry, vertices=vertices))


def frames(scenes, settings=SETTINGS, **options):
    """Indirect light of the frames, and the sequence."""
    with Sequence(SequenceSettings(**options), moving=["block"]) as sequence:
        layers = [render(sequence.begin(scene, i), settings, sequence=sequence).layers for i, scene in enumerate(scenes)]
        return [found["DiffuseIndirect"] for found in layers], dict(sequence.built)


def test_picture_at_rest_stands_still_and_has_less_noise(room):
    light, _ = frames([room] * 6, history=3)
    np.testing.assert_allclose(light[4], light[3], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(light[5], light[4], rtol=1e-4, atol=1e-6)
    truth = render(room, replace(SETTINGS, samples=128, gather=128, vpls=4096, seed=5)).layers["DiffuseIndirect"]
    alone, _ = frames([room], history=0)
    assert np.mean((light[5] - truth) ** 2) < 0.6 * np.mean((alone[0] - truth) ** 2)


def test_history_keeps_the_light_of_a_moving_camera(room):
    scenes = [moved_camera(room, (0.04 * k, 0, 0)) for k in range(6)]
    light, built = frames(scenes, history=5)
    alone = [frames([scene], history=0)[0][0] for scene in scenes[-1:]]
    truth = render(scenes[-1], replace(SETTINGS, samples=128, gather=128, vpls=4096, seed=5)).layers["DiffuseIndirect"]
    assert np.mean((light[-1] - truth) ** 2) < 0.7 * np.mean((alone[-1] - truth) ** 2)
    assert abs(light[-1].mean() / truth.mean() - 1) < 0.05
    assert built == {"rays": 1, "objects": 0, "emitters": 1, "views": 6, "particles": built["particles"]}


@pytest.mark.parametrize("kind", [sc.POINT, sc.SUN])
def test_a_lamp_that_is_not_seen_leaves_the_view_as_it_is(room, kind):
    def lit(along, aside):
        """By a lamp so far along the camera's axis, or a sun there."""
        f = np.float32
        place = (room.camera.matrix @ [aside, 0, -along, 1])[:3]
        towards = np.array([aside, 0, -along]) / np.hypot(aside, along)
        axes = np.array([[towards[2], 0, -towards[0]], [0, 1, 0], towards], f)
        lamp = sc.Lamps(
            np.full(1, kind, np.int32), np.array([place], f), axes[None], np.full((1, 3), 9, f), np.full(1, 0.1, f),
            np.zeros(1, np.uint8), np.full(1, 0.1, f), np.zeros(1, f), np.zeros((1, 2), f), np.zeros(1, np.int32),
            np.full(1, sc.ALL_RAYS, np.uint8), np.ones(1, np.uint8), ["lamp"], [""],
        )  # fmt: skip
        return replace(room, lamps=lamp)

    assert frames([lit(-1, 0), lit(-1, 0.1)], history=1)[1]["views"] == 1
    assert frames([lit(1, 0), lit(1, 0.1)], history=1)[1]["views"] == 2
    assert frames([polished(lit(-1, 0)), polished(lit(-1, 0.1))], history=1)[1]["views"] == 2  # a mirror may show it


def test_probes_are_renewed_in_turn_and_never_outlive_the_light(room):
    brighter = replace(room, world=replace(room.world, radiance=np.full((1, 1, 3), 1, np.float32)))
    scenes = [moved_camera(room, (0.04 * k, 0, 0)) for k in range(5)] + [brighter, brighter]
    traced = []
    with Sequence(SequenceSettings(history=2)) as sequence:
        for i, scene in enumerate(scenes):
            render(sequence.begin(scene, i), SETTINGS, sequence=sequence)
            traced.append(sequence._probes.traced)
    assert np.diff([0, *traced]).tolist() == [3, 1, 1, 1, 1, 3, 1]


def test_scouted_frames_stand_in_for_the_rendered_ones(room):
    scenes = [moved_camera(room, (0.05 * k, 0, 0)) for k in range(6)]
    whole, _ = frames(scenes, history=2)
    with Sequence(SequenceSettings(history=2)) as sequence:
        for i in (1, 2):
            scout(sequence.begin(scenes[i], i), SETTINGS, sequence)
        for i in (3, 4):
            remember(sequence.begin(scenes[i], i), SETTINGS, sequence)
        alone = render(sequence.begin(scenes[5], 5), SETTINGS, sequence=sequence).layers["DiffuseIndirect"]
    np.testing.assert_array_equal(alone, whole[5])


def test_moved_object_costs_no_rebuild_of_the_rest(room):
    _, built = frames([moved_block(room, (0.1 * k, 0, 0)) for k in range(4)], history=2)
    assert built["rays"] == 1
    assert built["objects"] == 3


def test_lamp_keeps_geometry_and_view(room):
    brighter = replace(room, world=replace(room.world, radiance=np.full((1, 1, 3), 1, np.float32)))
    dimmer = replace(room, lamps=room.lamps, world=room.world)
    _, built = frames([room, dimmer, brighter], history=2)
    assert (built["rays"], built["emitters"]) == (1, 2)


def test_sequence_without_history_is_independent_frames(room):
    scenes = [room, moved_block(room, (0.3, 0, 0))]
    light, _ = frames(scenes, history=0)
    for scene, found in zip(scenes, light):
        np.testing.assert_array_equal(found, render(scene, SETTINGS).layers["DiffuseIndirect"])


def estimates(scenes, light_of):
    """An estimate of each scene, whose light is a function of the position and object."""
    found = []
    with Sequence(SequenceSettings(history=len(scenes))) as sequence:
        for i, scene in enumerate(scenes):
            begun = sequence.begin(scene, i)
            render(begun, SETTINGS, sequence=sequence)
            estimate = sequence._estimates[-1]
            guide = estimate.guide
            light = np.concatenate([light_of(guide.position, guide.surface)] * 2, axis=2).astype(np.float32)
            found.append(replace(estimate, light=light))
    return found


@pytest.mark.parametrize("panorama", [False, True])
def test_reprojection_finds_the_same_place_and_nothing_else(room, panorama):
    if panorama:
        window = (-0.5 * np.pi, 0.5 * np.pi, -0.25 * np.pi, 0.25 * np.pi)
        room = replace(room, camera=replace(room.camera, panorama=True, window=window))
    scenes = [room, moved_camera(room, (0.3, 0.1, 0))]
    block = max(np.unique(estimates([room], lambda p, s: p)[0].guide.surface, return_counts=True)[0])
    before, now = estimates(scenes, lambda p, s: p + 100.0 * (s == block)[..., None])
    light, coverage = reproject(before, now, 1)
    known = coverage > 0
    assert 0.6 < known.mean() < 1  # what has come into view is not known
    pixel = 4 * (np.pi if panorama else 2) / SIZE
    assert np.abs(light - now.light)[known].max() < 2 * pixel  # never from the block to the wall behind


def test_noise_of_neighbouring_pixels_is_not_mixed(room):
    rng = np.random.default_rng(3)
    before, now = estimates([room, moved_camera(room, (0.3, 0.1, 0))], lambda p, s: rng.random(p.shape))
    light, coverage = reproject(before, now, 1)
    assert np.isin(light[coverage > 0], before.light).all()  # a mean would be correlated noise, which a denoiser takes for a texture


def test_the_denoiser_counts_the_rays_that_history_stands_for(room, monkeypatch):
    qualities = []
    original = Picture.denoised

    def denoised(self, *args, quality, **options):
        qualities.append(quality)
        return original(self, *args, quality=quality, **options)

    monkeypatch.setattr(Picture, "denoised", denoised)
    shared = SequenceSettings(history=1)
    settings = shared.frame(replace(SETTINGS, samples=8, gather=8, denoise=True))
    with Sequence(shared) as sequence:
        for k in range(2):
            render(sequence.begin(moved_camera(room, (0.1 * k, 0, 0)), k), settings, sequence=sequence)
    assert settings.samples == 4
    assert qualities[-1] == "balanced"


def test_a_frame_spends_on_edges_what_history_saves():
    asked = replace(SETTINGS, samples=8, pixel_samples=8, direct_samples=3)
    whole, frame, exposure = (SequenceSettings(**kind).frame(asked) for kind in ({"history": 0}, {}, {"motion_blur": 2}))
    assert (whole.pixel_samples, whole.direct_samples) == (8, 3)
    assert (frame.pixel_samples, frame.direct_samples) == (12, 3)
    assert (exposure.pixel_samples, exposure.direct_samples) == (8, 3)
    assert exposure.samples < frame.samples < whole.samples


def test_reprojection_follows_a_moving_object(room):
    shift = np.array([0.5, 0, 0])
    before, now = estimates([room, moved_block(room, shift)], lambda p, s: p)
    block = now.guide.surface[(now.guide.position != before.guide.position).any(axis=2)]
    block = np.bincount(block[block > 0]).argmax()
    light, coverage = reproject(before, now, 1)
    on = (now.guide.surface == block) & (coverage > 0)
    assert on.sum() > 0.5 * (now.guide.surface == block).sum()
    assert np.abs(light[on][:, :3] + shift - now.light[on][:, :3]).mean() < 0.1


def test_trust_is_lost_where_the_light_has_changed():
    rng = np.random.default_rng(2)
    now, before = rng.gamma(4, 0.25, (2, 64, 64, 3)).astype(np.float32)
    before[:, 32:] *= 0.5
    weight = trust(now, before, np.ones((64, 64), np.float32))
    assert weight[:, :24].mean() > 0.85
    assert weight[:, 40:].mean() < 0.35


@pytest.mark.parametrize("backend", ["embree", "bvh"])
def test_moved_rays_meet_what_a_fresh_scene_has(backend):
    rng = np.random.default_rng(3)
    vertices = (rng.random((300, 1, 3)) + 0.1 * rng.normal(size=(300, 3, 3))).astype(np.float32).reshape(-1, 3)
    triangles = np.arange(900, dtype=np.int32).reshape(-1, 3)
    moving = np.repeat(np.arange(10, dtype=np.int32), 30)
    transparent = rng.random(300) < 0.3
    elsewhere = vertices.copy()
    elsewhere[triangles[moving == 4]] += np.float32(0.3)
    shots = rng.random((2000, 3)).astype(np.float32), rng.normal(size=(2000, 3)).astype(np.float32)
    with (
        rays.RayScene(vertices, triangles, transparent=transparent, backend=backend, moving=moving) as moved,
        rays.RayScene(elsewhere, triangles, transparent=transparent, backend=backend) as fresh,
    ):
        assert moved.move(elsewhere, [4]) == (backend == "embree")
        assert not moved.move(elsewhere, [0])
        if backend == "embree":
            np.testing.assert_array_equal(rays.intersect(moved, *shots).triangle, rays.intersect(fresh, *shots).triangle)
        flat = elsewhere.copy()
        flat[triangles[121]] = 0
        assert not moved.move(flat, [4])  # a triangle has lost its area


def test_estimate_knows_objects_by_name(room):
    (estimate,) = estimates([room], lambda p, s: p)
    assert isinstance(estimate, Estimate)
    assert len(np.unique(estimate.guide.surface)) == 2


def test_packets_of_many_threads_meet_moving_objects(room):
    with Sequence(SequenceSettings(history=0), moving=["block", "box"]) as sequence:
        big = replace(room, camera=replace(room.camera, width=256, height=256, border=(0, 0, 256, 256)))
        settings = replace(SETTINGS, layers=("Albedo",), pixel_samples=1)
        apart = render(sequence.begin(big, 0), replace(settings, threads=8), sequence=sequence).layers
    np.testing.assert_array_equal(apart["Albedo"], render(big, settings).layers["Albedo"])
