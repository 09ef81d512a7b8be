"""What is given back to the denoised picture by the light of shading points."""

import numpy as np
import pytest

from lumigate.core import subpixel
from lumigate.core.subpixel import PART, PointLight, give_back, joined

H, W = 24, 32
UP, SIDE = (0, 0, 1), (1, 0, 0)


def light_of(pixel, position, normal, albedo, irradiance, foreseen=1.0, weight=1.0):
    """Grey points."""
    f, n = np.float32, len(pixel)
    grey = lambda values: np.repeat(np.broadcast_to(f(values), n)[:, None], 3, axis=1).copy()  # noqa: E731
    return PointLight(
        np.asarray(pixel, np.int32), np.asarray(position, f), np.broadcast_to(f(normal), (n, 3)).copy(), grey(albedo), grey(irradiance),
        np.broadcast_to(f(foreseen), n).copy(), np.ones(n, f), weight,
    )  # fmt: skip


def both(a, b, weight=None):
    return PointLight(*(np.concatenate([x, y]) for x, y in zip(a[:-1], b[:-1])), weight or a.weight)


def stairs(noise=0.0, seed=0, upper=2.0, lower=0.5):
    """A floor and a wall in every pixel, by turns more of one and of the other; the light of each; what the pixels show; what is foreseen."""
    rng = np.random.default_rng(seed)
    y, x = np.divmod(np.arange(H * W), W)
    share = np.where((x + y) % 2, 0.4, 0.1).astype(np.float32)
    zero = np.zeros(H * W)
    e = lambda value: value * (1 + noise * rng.standard_normal(H * W))  # noqa: E731
    floor = light_of(np.arange(H * W), np.stack([x, y, zero], 1), UP, share, e(upper))
    wall = light_of(np.arange(H * W), np.stack([zero + 100, y, x], 1), SIDE, 0.5 - share, e(lower))
    truth = np.repeat((share * upper + (0.5 - share) * lower)[:, None] / np.pi, 3, axis=1).reshape(H, W, 3).astype(np.float32)
    return both(floor, wall), truth, np.full((H, W, 3), 0.5, np.float32)


def test_what_differs_by_surface_is_given_back():
    # The denoiser has seen a pattern of single pixels, and has made one grey of it.
    light, truth, foreseen = stairs(noise=0.2)
    blurred = np.full_like(truth, truth.mean())
    found = give_back(blurred, foreseen, (light,))
    before, after = (np.sqrt(((image - truth) ** 2).mean()) for image in (blurred, found))
    assert after == pytest.approx((1 - PART) * before, rel=0.08)
    assert found.mean() == pytest.approx(truth.mean(), rel=0.01)


def test_noise_is_not_given_back():
    light, truth, foreseen = stairs(noise=1.0, upper=1.0, lower=1.0)
    found = give_back(truth, foreseen, (light,))
    raw = np.bincount(light.pixel, light.albedo[:, 0] * light.irradiance[:, 0], H * W).reshape(H, W) / np.pi
    assert np.sqrt(((found / truth - 1) ** 2).mean()) < 0.1 * np.sqrt(((raw / truth[..., 0] - 1) ** 2).mean())
    assert found.mean() == pytest.approx(truth.mean(), rel=0.005)


def test_few_rays_that_find_the_light_leave_no_smudges():
    """A seam of a wall, every fiftieth of whose points knows all of its light: between these all look dark, and alike."""
    rng = np.random.default_rng(7)
    y, x = np.divmod(np.arange(H * W), W)
    e = lambda n: 0.1 + 0.9 * 50 * (rng.random(n) < 0.02)  # noqa: E731
    wall = light_of(np.arange(H * W), np.stack([x, 0 * x, y], 1), (0, -1, 0), np.where(x == 16, 0.25, 0.5), e(H * W))
    beyond = light_of(*(column[x == 16] for column in wall[:3]), 0.25, e(H))
    clean = np.full((H, W, 3), 0.5 / np.pi, np.float32)
    found = give_back(clean, np.full_like(clean, 0.5), (both(wall, beyond),))
    assert found.min() > 0.8 * clean.min()


def test_a_pixel_of_one_surface_is_left_as_it_is():
    light, truth, foreseen = stairs(noise=0.5)
    alone = PointLight(*(column[: H * W] for column in light[:-1]), 1.0)
    np.testing.assert_array_equal(give_back(truth, foreseen, (alone,)), truth)


def test_light_is_never_negative():
    light, truth, foreseen = stairs(upper=0.0, lower=0.0)
    found = give_back(truth + np.float32(0.1), foreseen, (light,))
    assert found.min() >= 0 and np.isfinite(found).all()


def test_a_wall_round_a_bright_hole_keeps_its_light():
    # The pixels of the hole's rim show some wall, too, of which the denoised ratio says that it is a thousand times too bright.
    y, x = np.divmod(np.arange(H * W), W)
    zero = np.zeros(H * W)
    rim = (np.abs(x - 15) <= 1) & (np.abs(y - 12) <= 1)
    wall = light_of(np.arange(H * W), np.stack([x, y, zero], 1), UP, np.where(rim, 0.2, 0.5), 1.0)
    hole = light_of(np.flatnonzero(rim), np.stack([x, y, zero - 1], 1)[rim], SIDE, 0.3, 5000.0)
    light = both(wall, hole)
    truth = np.bincount(light.pixel, light.albedo[:, 0] * light.irradiance[:, 0] / np.pi, H * W).astype(np.float32)
    truth = truth.reshape(H, W, 1).repeat(3, axis=2)
    found = give_back(truth, np.full((H, W, 3), 0.5, np.float32), (light,))
    np.testing.assert_allclose(found.reshape(-1, 3)[~rim], truth.reshape(-1, 3)[~rim], rtol=0.3)


def test_threads_give_the_same_bits():
    light, truth, foreseen = stairs(noise=0.5)
    np.testing.assert_array_equal(give_back(truth, foreseen, (light,), threads=1), give_back(truth, foreseen, (light,), threads=2))


def test_passes_count_by_their_weight():
    light, truth, foreseen = stairs(noise=0.3)
    blurred = np.full_like(truth, truth.mean())
    once = give_back(blurred, foreseen, (light,))
    half, quarter = light._replace(weight=3.0), light._replace(weight=1.0)
    np.testing.assert_allclose(give_back(blurred, foreseen, (half, quarter)), once, rtol=1e-5)


def test_further_passes_are_kept_while_there_is_room(monkeypatch):
    light = stairs()[0]
    monkeypatch.setattr(subpixel, "MOST_POINTS", 2 * len(light.pixel))
    assert len(joined((light,), (light, light))) == 2
    assert len(joined((), (light,))) == 1


def oracle(clean, foreseen, light, noisier):
    """`give_back` of one pass, point by point, in double precision."""
    ratio = np.pi * clean.astype(float) / foreseen
    pixel = light.pixel
    share = light.albedo.sum(1) / np.bincount(pixel, light.albedo.sum(1), H * W)[pixel]
    rays = np.minimum(2 * share, 1)
    residual = light.irradiance - light.foreseen[:, None] * ratio.reshape(-1, 3)[pixel]
    y, x = np.divmod(pixel, W)
    total = ratio.reshape(-1, 3).sum(1)[pixel]
    out = clean.astype(float).reshape(-1, 3).copy()
    several = np.bincount(pixel, minlength=H * W).reshape(H, W) > 1
    for p in range(len(pixel)):
        if not several[max(y[p] - 1, 0) : y[p] + 2, max(x[p] - 1, 0) : x[p] + 2].any():
            continue
        cosine = light.normal @ light.normal[p]
        near = (np.abs(y - y[p]) <= 4) & (np.abs(x - x[p]) <= 4) & (cosine > 0.3)
        e = light.position[near] - light.position[p]
        off = (e @ light.normal[p]) / 1.5
        unlike = (total[near] - total[p]) / (total[near] + total[p])
        u = 1 + 0.5 * (2 * ((y[near] - y[p]) ** 2 + (x[near] - x[p]) ** 2) / 16 + off**2 + (e**2).sum(1) / 400 + 4 * unlike**2)
        w = cosine[near] ** 4 * rays[near] / u**3 * np.minimum(1, 4 * total[p] / total[near]) ** 2
        f, r = w * light.foreseen[near], w[:, None] * residual[near]
        number, mean = f.sum() ** 2 / (f**2).sum(), r.sum() / f.sum()
        if number <= 1.5:
            continue
        noise = ((r.sum(1) - mean * f) ** 2).sum() / f.sum() ** 2 * number / (number - 1)
        noise *= noisier
        if mean < 0:  # at least as noisy as points are in the tiles around
            tiles = (np.abs(y // 16 - y[p] // 16) <= 1) & (np.abs(x // 16 - x[p] // 16) <= 1)
            usual = (rays * residual.sum(1) ** 2)[tiles].sum() / (rays * (light.foreseen * total) ** 2)[tiles].sum()
            noise = max(noise, usual * total[p] ** 2 / number)
        given = 0.6 * max(0, 1 - noise / mean**2) * r.sum(0) / f.sum()
        out[pixel[p]] += light.albedo[p] * light.foreseen[p] * np.maximum(given, -ratio.reshape(-1, 3)[pixel[p]]) / np.pi
    return np.maximum(out, 0).reshape(clean.shape)


@pytest.mark.parametrize(("few", "noisier"), [(False, 2), (True, 4)])
def test_the_kernels_are_the_oracle(few, noisier):
    rng = np.random.default_rng(5)
    n = 2500
    normal = rng.standard_normal((n, 3))
    light = light_of(
        rng.integers(0, H * W, n), rng.uniform(0, 20, (n, 3)), UP, rng.uniform(0.1, 1, n), rng.exponential(1, n), rng.uniform(0.5, 2, n)
    )
    light = light._replace(normal=(normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32))
    light = light._replace(irradiance=light.irradiance * rng.uniform(0.5, 1, (n, 3)).astype(np.float32))
    foreseen = (
        np.maximum(np.bincount(light.pixel, light.albedo[:, 0] * light.foreseen, H * W), 1e-3)
        .reshape(H, W, 1)
        .repeat(3, 2)
        .astype(np.float32)
    )
    clean = rng.uniform(0.1, 1, (H, W, 3)).astype(np.float32)
    np.testing.assert_allclose(give_back(clean, foreseen, (light,), few=few), oracle(clean, foreseen, light, noisier), rtol=2e-3, atol=1e-4)
