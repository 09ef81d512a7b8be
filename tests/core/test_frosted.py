"""Frosted glass: its blur against refraction at microfacets, and the shading points that show it."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.picture import denoising_guides
from lumigate.core.surfaces import frosted, ggx, rough_glass
from lumigate.core.surfaces.layout import BEND, FROST, REFRACTION, STRAY, TRANSPARENCY
from lumigate.core.surfaces.lobes import LOBE, sample_lobe, set_lobe
from lumigate.headless.stress.arrays import camera, geometry, materials, quads, scene

from .test_view import seen, shown, wall

F = np.float32
IOR = 1.5


def refracted(o, h, eta):
    """Directions into which views o (N, 3) are refracted at normals h, `eta` the index behind over that before, and what is reflected there."""
    c = np.einsum("nc,nc->n", o, h)
    root = 1 - (1 - c * c) / eta**2
    t = np.sqrt(np.maximum(root, 0))
    across, along = (c - eta * t) / (c + eta * t), (t - eta * c) / (t + eta * c)
    reflected = np.where(root > 0, 0.5 * (across**2 + along**2), 1)
    return -o / eta + (c / eta - t)[:, None] * h, reflected


def microfacets(rng, n, alpha):
    """(N, 3) normals of a GGX surface with the weight of those that an upright view sees: by their area in projection."""
    u, phi = rng.random(n), 2 * np.pi * rng.random(n)
    slope = alpha * np.sqrt(u / (1 - u))
    return np.stack([slope * np.cos(phi), slope * np.sin(phi), np.ones(n)], 1) / np.sqrt(1 + slope**2)[:, None]


def median_angle(directions, weights, straight):
    angle = np.arccos(np.clip(directions @ straight, -1, 1))
    order = np.argsort(angle)
    return angle[order][np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)]


def mirrored_median(alpha, cosine, n=4000):
    """Median angle between the mirror's direction and those drawn from a lobe of width alpha."""
    lobe, rng = np.zeros(LOBE, F), np.random.default_rng(2)
    sine = np.sqrt(1 - cosine * cosine)
    set_lobe(lobe, *F([0, 0, 1, 0, 0, 1, sine, 0, cosine, np.sqrt(alpha), 1, 1, 1, 1, 1, 1]))
    drawn = np.array([sample_lobe(lobe, F(rng.random()), F(rng.random()))[:4] for _ in range(n)])
    return median_angle(drawn[:, :3], drawn[:, 3], np.array([-sine, 0, cosine]))


@pytest.mark.parametrize("cosine", [1.0, 0.8, 0.5])
def test_one_surface_blurs_as_the_mirror_whose_image_lies_behind(cosine):
    """A view refracted at a tilted facet, and bent back by a smooth surface, leaves as far from the straight way as the opposite facet of the lobe sends it."""
    sine, slope = np.sqrt(1 - cosine * cosine), 1e-3
    o = np.array([[sine, 0, cosine]])
    for facet in ([slope, 0, 1], [0, slope, 1]):
        h = np.array([facet]) / np.linalg.norm(facet)
        inside, _ = refracted(o, h, IOR)
        outside, _ = refracted(-inside, np.array([[0.0, 0, 1]]), 1 / IOR)
        narrower = float(frosted.lobe_alpha(F(1), F(IOR), F(cosine))) * np.array(facet) * (-1, -1, 0) + (0, 0, 1)
        narrower /= np.linalg.norm(narrower)
        image = 2 * (o[0] @ narrower) * narrower - o[0]
        np.testing.assert_allclose(outside[0], image * (1, 1, -1), atol=2e-6)


@pytest.mark.parametrize("roughness", [0.2, 0.4, 0.6])
def test_both_sides_of_a_pane_blur_one_after_the_other(roughness):
    rng, n, alpha = np.random.default_rng(1), 100000, roughness**2
    o = np.tile([0.0, 0, 1], (n, 1))
    inside, lost = refracted(o, microfacets(rng, n, alpha), IOR)
    weight = 1 - lost
    outside, lost = refracted(-inside, microfacets(rng, n, alpha), 1 / IOR)
    weight *= (1 - lost) * (outside[:, 2] < 0)
    one = frosted.lobe_alpha(F(roughness), F(IOR), F(1))
    both = frosted.joined_alpha(one, one)
    assert both > 1.3 * one
    assert mirrored_median(both, 1.0) == pytest.approx(median_angle(outside, weight, np.array([0, 0, -1.0])), rel=0.08)


@pytest.mark.parametrize("roughness", [0.2, 0.4, 0.8])
def test_what_is_left_to_blur_makes_up_for_what_others_have_blurred(roughness):
    one = frosted.lobe_alpha(F(roughness), F(IOR), F(1))
    for first in (F(0), F(0.3) * one, one):
        rest = frosted.rest_alpha(first, one)
        assert (first**1.35 + rest**1.35) ** (1 / 1.35) == pytest.approx(float(one), rel=1e-4)
    assert frosted.rest_alpha(one, F(0.5) * one) == 0


def shadowing(cosine, alpha):
    """Smith's Lambda."""
    return 0.5 * (np.sqrt(1 + alpha**2 * (1 / np.maximum(cosine, 1e-6) ** 2 - 1)) - 1)


def met(rng, o, eta, alpha, once):
    """Views o (N, 3) of a rough surface: (whether they go on through it, directions on the side where they are then, weights).

    Each meets one visible normal, drawn out of 64 by their areas, and does as Fresnel's equations and Smith's shadowing say.  once: whether that loses light, which is else made up
    for by the mean of what views of the same cosine keep.
    """
    tried = microfacets(rng, 64 * len(o), alpha).reshape(64, len(o), 3)
    area = np.cumsum(np.maximum((tried * o).sum(2), 0) / tried[..., 2], axis=0)  # in projection, over that seen from above
    picked = np.minimum((area < rng.random(len(o)) * area[-1]).sum(0), 63)
    h = tried[picked, np.arange(len(o))]
    onwards, share = refracted(o, h, eta)
    passes = rng.random(len(o)) >= share
    turned = np.where(passes[:, None], onwards * (1, 1, -1), 2 * (o * h).sum(1)[:, None] * h - o)
    here = 1 + shadowing(o[:, 2], alpha)
    weight = np.where(turned[:, 2] > 0, here / (here + shadowing(turned[:, 2], alpha)), 0)
    if not once:
        cell = np.minimum((o[:, 2] * 24).astype(int), 23)
        kept = np.bincount(cell, weight, 24) / np.maximum(np.bincount(cell, minlength=24), 1)
        weight = np.divide(weight, kept[cell], out=np.zeros_like(weight), where=kept[cell] > 0)
    return passes, turned, weight


@pytest.mark.parametrize("once", [False, True], ids=["multiple", "once"])
@pytest.mark.parametrize("cosine", [1.0, 0.5])
@pytest.mark.parametrize("roughness", [0.4, 0.8])
def test_rough_panes_let_through_what_paths_to_and_fro_within_them_do(roughness, cosine, once):
    """To Cycles, whose glass loses no light, a pane of a roughness of .8 is as clear as a smooth one; by what leaves a side at once alone it had 60 % of that."""
    rng, n, alpha = np.random.default_rng(3), 40000, roughness**2
    o = np.tile([np.sqrt(1 - cosine**2), 0, cosine], (n, 1))
    passes, o, weight = met(rng, o, IOR, alpha, once)
    o, weight = o[passes], weight[passes]
    through = 0.0
    for side in range(24):
        passes, o, more = met(rng, o, 1 / IOR, alpha, once)
        weight = weight * more
        through += weight[passes].sum() / n if side % 2 == 0 else 0
        keep = ~passes & (weight > 0)
        o, weight = o[keep], weight[keep]
        if not len(o):
            break
    kind = rough_glass.SINGLE if once else rough_glass.MULTIPLE
    z = F(ggx.ior_coordinate(IOR))
    _, reflected = refracted(np.array([[np.sqrt(1 - cosine**2), 0, cosine]]), np.array([[0, 0, 1.0]]), IOR)
    pane = (1 - reflected[0]) / (1 + reflected[0]) + rough_glass.more_by_pane(kind, z, F(cosine), F(roughness))
    assert pane == pytest.approx(through, abs=0.03)
    passes, _, weight = met(rng, np.tile([np.sqrt(1 - cosine**2), 0, cosine], (n, 1)), 1 / IOR, alpha, once)
    out = rough_glass.passed_from_within(kind, F(IOR), z, F(cosine), F(roughness))
    assert out == pytest.approx(weight[passes].sum() / n, abs=0.03)


def before_a_pane(frost, panes=1, share=0.8):
    """A camera that looks at a diffuse wall 5 m away through panes of glass at 2 m and farther, whose blur is `frost`."""
    stuff = materials((0.5, 0.0), (0.0, 0.0), (0.0, 0.0))
    stuff.tables.flags[1] |= sc.TRANSPARENT | sc.REFRACTIVE | sc.FROSTED
    for at in (TRANSPARENCY, REFRACTION):
        stuff.tables.constant[1, at : at + 3] = share
    stuff.tables.constant[1, FROST] = frost
    stuff.tables.constant[1, STRAY] = frost / frosted.lobe_alpha(F(1), F(IOR), F(1))
    g = geometry(*quads(wall(-5), *(wall(-2 - 0.5 * k) for k in range(panes))), np.repeat([0] + panes * [1], 2))
    g.object[:] = np.repeat(np.arange(1 + panes), 2)
    g.object_names, g.object_visibility = [f"object {i}" for i in range(1 + panes)], np.full(1 + panes, sc.ALL_RAYS, np.uint8)
    return scene(g, stuff, camera=camera())


def test_a_rough_pane_has_a_lobe_that_shows_what_lies_behind():
    points = seen(before_a_pane(0.1), 16).points
    assert len(points.pixel) == 16 * 16 and not points.behind_glass.any() and not points.shown.any() and not points.albedo.any()
    np.testing.assert_allclose(points.f0, 0.8, rtol=1e-5)
    np.testing.assert_array_equal(points.f0, points.f90)
    np.testing.assert_allclose(points.roughness**2, 0.1, rtol=1e-5)
    np.testing.assert_allclose(points.ns, np.broadcast_to((0, 0, -1), points.ns.shape), atol=1e-5)
    # Its mirror's direction is straight on, away from the camera in the origin.
    mirrored = 2 * np.einsum("nc,nc->n", points.wo, points.ns)[:, None] * points.ns - points.wo
    np.testing.assert_allclose(mirrored, points.position / np.linalg.norm(points.position, axis=1)[:, None], atol=2e-2)
    np.testing.assert_array_equal(points.entered, 1)


def test_a_second_surface_blurs_as_well_and_has_no_lobe_of_its_own():
    points = seen(before_a_pane(0.1, panes=2), 16).points
    assert len(points.pixel) == 16 * 16
    np.testing.assert_allclose(points.position[:, 2], -2, rtol=1e-5)
    np.testing.assert_allclose(points.roughness**2, frosted.joined_alpha(F(0.1), F(0.1)), rtol=1e-4)
    np.testing.assert_allclose(points.f0, 0.8, rtol=1e-5)  # rays of the lobe meet the second surface themselves


def test_a_view_through_a_little_roughness_meets_surfaces_and_leaves_lamps_to_the_lobe():
    clear, picture = (seen(before_a_pane(frost), 64) for frost in (0.0, 0.009))
    assert not clear.points.f0.any()
    points = picture.points
    pane = points.behind_glass == 0
    assert points.shown[pane].all() and not points.shown[~pane].any()
    np.testing.assert_allclose(shown(picture, points.f0 * pane[:, None]), 0.8, rtol=1e-4)
    assert shown(picture, points.albedo).mean() == pytest.approx(0.8 * 0.5, rel=0.02)
    spread = np.concatenate([points.position[~pane, :2], clear.points.position[:, :2]])
    assert np.ptp(spread[: (~pane).sum()]) > 1.005 * np.ptp(clear.points.position[:, :2])  # beyond the frame, too


@pytest.mark.parametrize("bend", [1.0, IOR], ids=["thin", "solid"])
def test_chance_behind_frosted_glass_leaves_no_noise_in_the_denoisers_guide(bend):
    # One of the two triangles of the wall is black: what a sample meets near their border is chance, and the guide has to be even there.
    made = before_a_pane(0.009)
    made.materials.tables.constant[1, BEND] = bend
    made.geometry.material[1] = 2
    view = seen(made, 4)
    noisy = shown(view, view.points.albedo).reshape(view.shape)
    albedo, normal = denoising_guides(view)
    inner = np.s_[4:-4, 4:-4]

    def uneven(image):
        return np.abs(np.diff(image[inner], n=2, axis=0)).mean()

    assert albedo[inner].mean() == pytest.approx(float(noisy[inner].mean()), rel=0.07)
    assert uneven(albedo.mean(axis=-1)) < 0.4 * uneven(noisy)
    np.testing.assert_allclose(normal, view.mean_normal, atol=1e-6)
