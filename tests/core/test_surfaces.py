"""Material programs: layering and energy, textures, interpolation, threads."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core import scene as sc
from lumigate.core.surfaces import colors, ggx, layout, outlined, textures
from lumigate.core.surfaces import program as ops
from lumigate.core.surfaces.batch import evaluate_batch

F = np.float32
R = ops.REGISTERS


def tables_of(instructions, constants, **others):
    """Tables of one material; operands of the instructions are registers, or R + index of a constant."""
    code = np.zeros((len(instructions) + 1, 8), np.int32)
    for row, (op, destination, *operands, p) in zip(code, instructions):
        row[:2] = op, destination
        row[2:7] = R
        row[2 : 2 + len(operands)] = operands
        row[7] = p
    code[-1, 0] = ops.END
    return ops.empty_tables()._replace(
        code=code,
        constants=np.array(constants, F),
        start=np.zeros(1, np.int32),
        flags=np.zeros(1, np.int32),
        constant=np.zeros((1, layout.SURFACE), F),
        functions=outlined.addresses({i[0] for i in instructions}),
        **others,
    )


def evaluate(tables, n=1, attributes=None, triangle=None, u=0.0, v=0.0, cosine=ops.MEAN_VIEW, threads=1):
    """Surfaces of n points of material 0."""
    attributes = np.zeros((1, 1, 3, 4), F) if attributes is None else attributes
    triangle = np.zeros(n, np.int32) if triangle is None else triangle
    materials = np.zeros(attributes.shape[1], np.int32)
    return evaluate_batch(tables, materials, attributes, triangle, np.broadcast_to(u, n), np.broadcast_to(v, n), cosine, threads)


def principled(base, roughness, ior, level, coat=0.0, multiple=1):
    """Tables of a dielectric over a diffuse base, under a coat."""
    constants = [(0,) * 4, (1,) * 4, (*base, 1), (roughness, ior, level, 1), (coat, 0.1, 1.5, 1)]
    instructions = [
        (ops.COAT_CLOSURE, 0, R + 4, R + 1, R, R + 1, 0),
        (ops.DIELECTRIC_CLOSURE, 1, R + 2, R + 3, R + 1, 0, multiple),
    ]
    return tables_of(instructions, constants)


def test_ggx_tables_match_a_random_walk_over_the_microfacets():
    """An estimate that shares no code: normals drawn from the plain distribution, weighted by visibility."""
    rng = np.random.default_rng(5)
    n = 200_000
    for z_index, mu_index, r_index in ((7, 8, 8), (5, 12, 15), (10, 3, 5), (7, 15, 10)):
        roughness, mu, z = r_index / 15, mu_index / 15, z_index / 15
        alpha = roughness**2
        cos2 = 1 / (1 + alpha**2 * (x := rng.random(n)) / (1 - x))
        phi = 2 * np.pi * rng.random(n)
        sin_h, cos_h = np.sqrt(1 - cos2), np.sqrt(cos2)
        i_h = np.maximum(math.sqrt(1 - mu**2) * sin_h * np.cos(phi) + mu * cos_h, 0)
        weight = i_h / cos_h  # visible area of the microfacet
        ior = (1 + z * z) / (1 - z * z)
        g = np.sqrt(ior**2 - 1 + i_h**2)
        fresnel = 0.5 * ((g - i_h) / (g + i_h)) ** 2 * (1 + ((i_h * (g + i_h) - 1) / (i_h * (g - i_h) + 1)) ** 2)
        f0 = ((ior - 1) / (ior + 1)) ** 2
        above = 2 * i_h * cos_h > mu
        expected = (weight * above * (fresnel - f0) / (1 - f0)).sum() / weight.sum()
        assert ggx.S_TABLE[z_index, mu_index, r_index] == pytest.approx(expected, abs=0.006)


def test_means_of_the_layer_are_its_hemispherical_integral():
    mu = (np.arange(400) + 0.5) / 400
    for f0, ior, roughness, multiple in ((0.04, 1.5, 0.5, 1.0), (0.08, 1.8, 0.2, 0.3), (0.3, 3.0, 1.0, 0.1), (0.0, 1.3, 0.9, 0.0)):
        z = ggx.ior_coordinate(ior)
        values = [ggx.layer_albedo(F(f0), F(z), F(roughness), F(multiple), F(m)) for m in mu]
        expected = np.mean(2 * mu * values)
        assert ggx.layer_albedo_mean(F(f0), F(z), F(roughness), F(multiple)) == pytest.approx(expected, abs=2e-3)


def mean_over_cosines(albedo, surface, n=64):
    """Mean of `albedo(surface, cosine)` over the cosine-weighted hemisphere."""
    mu = (np.arange(n, dtype=F) + F(0.5)) / F(n)
    return np.average([albedo(surface, m) for m in mu], axis=0, weights=mu)


@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("ior", [1.1, 1.5, 2.5])
def test_white_base_and_its_lobe_reflect_everything(roughness, ior):
    surface = evaluate(principled((1, 1, 1), roughness, ior, 0.5))[0]
    total = layout.diffuse_albedo_average(surface) + mean_over_cosines(layout.glossy_albedo, surface)
    # One Fresnel curve, an index of 1.5's, stands for all lobes: 3 % too much of one of 1.1.
    np.testing.assert_allclose(total, 1, atol=0.02 if ior > 1.1 else 0.035)


def test_coat_takes_from_the_base_what_it_reflects():
    bare, coated = (evaluate(principled((0.5, 0.5, 0.5), 0.4, 1.5, 0.0, c))[0] for c in (0.0, 1.0))
    kept = coated[layout.DIFFUSE] / bare[layout.DIFFUSE]
    np.testing.assert_allclose(kept, 1 - 0.092, atol=0.01)  # mean Fresnel term of an index of 1.5
    gained = (mean_over_cosines(layout.glossy_albedo, coated) - mean_over_cosines(layout.glossy_albedo, bare))[0]
    np.testing.assert_allclose(gained, 0.092, atol=0.01)


def test_mean_view_is_the_mean_over_the_views():
    tables = principled((0.6, 0.3, 0.1), 0.4, 1.5, 0.5, coat=0.8)
    mu = (np.arange(64, dtype=F) + F(0.5)) / 64
    views = evaluate(tables, 64, cosine=mu)
    weight = 2 * mu / mu.size
    expected = sum(w * np.array(layout.diffuse_albedo(s, m)) for s, m, w in zip(views, mu, weight))
    got = layout.diffuse_albedo_average(evaluate(tables)[0])
    np.testing.assert_allclose(got, expected, rtol=0.01)


@given(st.lists(st.floats(0, 2, width=32), min_size=8, max_size=8))
@settings(max_examples=60, deadline=None)
def test_albedos_stay_between_0_and_1_for_any_inputs(x):
    surface = evaluate(principled(x[:3], x[3], 0.5 + x[4], x[5], x[6], multiple=int(x[7] > 1)))[0]
    assert np.isfinite(surface).all() and (np.delete(surface, layout.GLOSS) >= 0).all()
    for cosine in (0.0, 0.3, 1.0):
        diffuse = layout.diffuse_albedo(surface, F(cosine))
        assert all(0 <= d <= max(x[:3]) + 1e-5 for d in diffuse)
        assert all(0 <= g < np.inf for g in layout.glossy_albedo(surface, F(cosine)))


def test_attributes_are_interpolated_between_the_corners():
    tables = tables_of([(ops.ATTRIBUTE, 0, 1), (ops.EMISSION_CLOSURE, 1, 0, R, R, R + 1, 0)], [(0,) * 4, (1,) * 4])
    attributes = np.random.default_rng(2).random((2, 3, 3, 4)).astype(F)
    for k, (u, v) in enumerate(((0, 0), (1, 0), (0, 1))):
        got = evaluate(tables, 3, attributes, np.arange(3, dtype=np.int32), u, v)
        np.testing.assert_allclose(got[:, layout.EMISSION : layout.EMISSION + 3], attributes[1, :, k, :3], rtol=1e-6)
    middle = evaluate(tables, 3, attributes, np.arange(3, dtype=np.int32), 1 / 3, 1 / 3)
    np.testing.assert_allclose(middle[:, layout.EMISSION : layout.EMISSION + 3], attributes[1, :, :, :3].mean(1), rtol=1e-5)


def test_constant_materials_are_copied_and_misses_are_zero():
    constant = np.arange(2 * layout.SURFACE, dtype=F).reshape(2, -1)
    tables = ops.empty_tables()._replace(flags=np.full(2, sc.CONSTANT, np.int32), constant=constant, start=np.zeros(2, np.int32))
    triangle = np.array([1, -1, 0], np.int32)
    zeros = np.zeros(3)
    got = evaluate_batch(tables, np.array([0, 1], np.int32), np.zeros((0, 2, 3, 4), F), triangle, zeros, zeros)
    np.testing.assert_array_equal(got, [constant[1], 0 * constant[0], constant[0]])


def test_same_bits_for_any_number_of_threads():
    rng = np.random.default_rng(0)
    tables = tables_of(
        [
            (ops.ATTRIBUTE, 0, 0),
            (outlined.COLOR_MODEL, 1, 0, colors.RGB_TO_HSV),
            (ops.DIELECTRIC_CLOSURE, 2, 1, R + 2, R + 1, R + 1, 1),
        ],
        [(0,) * 4, (1,) * 4, (0.4, 1.45, 0.5, 1)],
    )
    attributes = rng.random((1, 50, 3, 4)).astype(F)
    n = 10_000
    triangle = rng.integers(-1, 50, n).astype(np.int32)
    u, v = rng.random((2, n)).astype(F) / 2
    cosine = rng.random(n).astype(F)
    one, three = (evaluate(tables, n, attributes, triangle, u, v, cosine, threads) for threads in (1, 3))
    np.testing.assert_array_equal(one, three)
    assert evaluate(tables, 0, attributes).shape == (0, layout.SURFACE)


def _bilinear(image, extension, u, v):
    """Reference: one tap after the other, in float64."""
    height, width, _ = image.shape

    def texel(i, j):
        if extension == textures.REPEAT:
            return image[j % height, i % width]
        if extension == textures.EXTEND:
            return image[min(max(j, 0), height - 1), min(max(i, 0), width - 1)]
        if extension == textures.CLIP:
            return image[j, i] if 0 <= i < width and 0 <= j < height else np.zeros(3)
        i, j = i % (2 * width), j % (2 * height)
        return image[min(j, 2 * height - 1 - j), min(i, 2 * width - 1 - i)]

    x, y = u * width - 0.5, v * height - 0.5
    i, j = math.floor(x), math.floor(y)
    s, t = x - i, y - j
    low = (1 - s) * texel(i, j) + s * texel(i + 1, j)
    high = (1 - s) * texel(i, j + 1) + s * texel(i + 1, j + 1)
    return (1 - t) * low + t * high


@given(st.floats(-5, 5, width=32), st.floats(-5, 5, width=32), st.sampled_from(range(4)))
@settings(deadline=None)
def test_linear_lookup(u, v, extension):
    image = np.random.default_rng(1).integers(0, 256, (5, 4, 3)).astype(np.uint8)
    pool = textures.TexturePool()
    pool.add("it", lambda: image, extension, textures.LINEAR, 0)
    got = textures.sample(*pool.tables(), 0, F(u), F(v))[:3]
    np.testing.assert_allclose(got, _bilinear(image / 255.0, extension, u, v), atol=2e-5)


def test_srgb_table_is_the_curve():
    image = np.arange(256, dtype=np.uint8)[None, :, None]
    pool = textures.TexturePool()
    pool.add("it", lambda: image, textures.EXTEND, textures.CLOSEST, textures.SRGB)
    x = np.arange(256) / 255
    expected = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    got = [textures.sample(*pool.tables(), 0, F((i + 0.5) / 256), F(0.5))[0] for i in range(256)]
    np.testing.assert_allclose(got, expected, atol=1e-6)


def test_pool_keeps_bytes_and_floats_apart():
    pool = textures.TexturePool()
    grey = pool.add("bytes", lambda: np.full((2, 2, 1), 51, np.uint8), textures.REPEAT, textures.CLOSEST, 0)
    hdr = pool.add("floats", lambda: np.full((1, 3, 4), 7.5, F), textures.REPEAT, textures.CLOSEST, 0)
    header, texels_u8, texels_f32 = pool.tables()
    assert (texels_u8.size, texels_f32.size) == (4, 12)
    np.testing.assert_allclose(textures.sample(header, texels_u8, texels_f32, grey, F(0.1), F(0.1)), (0.2, 0.2, 0.2, 1))
    np.testing.assert_allclose(textures.sample(header, texels_u8, texels_f32, hdr, F(0.1), F(0.1)), (7.5,) * 4)


def test_mixed_lobes_keep_the_share_of_each():
    """Half a layered base and half a bare one: the lobe covers half of the diffuse albedo."""
    constants = [(0,) * 4, (0.5,) * 4, (1,) * 4, (0.8, 0.4, 0.2, 1), (0.3, 1.5, 0.5, 1)]
    tables = tables_of(
        [(ops.DIELECTRIC_CLOSURE, 0, R + 3, R + 4, R + 2, R + 1, 1), (ops.DIFFUSE_CLOSURE, 1, R + 3, R, R, R + 1, 0)], constants
    )
    surface = evaluate(tables)[0]
    np.testing.assert_allclose(surface[layout.DIFFUSE : layout.DIFFUSE + 3], (0.8, 0.4, 0.2), rtol=1e-6)
    np.testing.assert_allclose(surface[layout.LAYERED : layout.LAYERED + 3], (0.4, 0.2, 0.1), rtol=1e-6)
    assert surface[layout.LAYER_F0] == pytest.approx(0.04)
    assert surface[layout.LAYER_ROUGHNESS] == pytest.approx(0.3)


def test_reflected_views_have_the_albedo_of_the_cameras_view():
    """Only what asks whether the camera looks can tell them apart."""
    tables = principled((0.6, 0.3, 0.1), 0.4, 1.5, 0.5, coat=0.8)
    cosine = np.array([-1, -0.3, 0.2, 0.9], F)
    camera = evaluate(tables, 4, cosine=cosine)
    others = evaluate(tables, 4, cosine=np.array([ops.reflected_view(c) for c in cosine], F))
    np.testing.assert_allclose(camera, others, atol=1e-6)
    emits = tables_of([(ops.VIEWED, 0, sc.CAMERA), (ops.EMISSION_CLOSURE, 1, 0, R, R, R + 1, 0)], [(0,) * 4, (1,) * 4])
    views = np.array([0.5, -0.5, ops.reflected_view(F(0.5)), ops.reflected_view(F(-0.5)), ops.MEAN_VIEW], F)
    np.testing.assert_array_equal(evaluate(emits, 5, cosine=views)[:, layout.EMISSION], [1, 1, 0, 0, 0])


def glass(roughness=0.0, ior=1.5, thin=0, op=ops.GLASS_CLOSURE):
    """Tables of white glass."""
    if op == ops.REFRACTION_CLOSURE:
        return tables_of([(op, 0, R + 1, R + 2, R, R + 1, 0)], [(0,) * 4, (1,) * 4, (roughness, ior, 0, 1)])
    return tables_of([(op, 0, R + 1, R + 2, R + 1, R + 1, thin)], [(0,) * 4, (1,) * 4, (roughness, ior, 0, 1)])


def fresnel_within(cosine, ior):
    """Reflectance of light that comes at `cosine` from within a dielectric (Fresnel's equations)."""
    sine = ior * np.sqrt(1 - cosine * cosine)
    beyond = np.sqrt(np.maximum(0, 1 - sine * sine))
    across, along = (ior * cosine - beyond) / (ior * cosine + beyond), (cosine - ior * beyond) / (cosine + ior * beyond)
    return np.where(sine >= 1, 1.0, 0.5 * (across * across + along * along))


@pytest.mark.parametrize("ior", [1.33, 1.5, 2.2])
def test_glass_reflects_from_within_as_fresnel_says(ior):
    cosine = np.array([0.01, 0.3, 0.6, 0.75, 0.8, 0.95, 1.0], F)
    expected = fresnel_within(cosine.astype(float), ior)
    for views in (-cosine, np.array([ops.reflected_view(c) for c in -cosine], F)):
        within = np.array([ops.from_within(c) for c in views], F)
        surfaces = evaluate(glass(ior=ior), len(cosine), cosine=within)
        np.testing.assert_allclose(surfaces[:, layout.TRANSPARENCY], 1 - expected, atol=2e-5)
        for at in (layout.GLOSSY_F0, layout.GLOSSY_F90):
            np.testing.assert_allclose(surfaces[:, at], expected, atol=2e-5)
        rough = evaluate(glass(roughness=0.5, ior=ior), len(cosine), cosine=within)
        np.testing.assert_allclose(rough[:, layout.TRANSPARENCY] + rough[:, layout.GLOSSY_F0], 1, atol=1e-6)
        refracted = evaluate(glass(ior=ior, op=ops.REFRACTION_CLOSURE), len(cosine), cosine=within)
        np.testing.assert_array_equal(refracted[:, layout.REFRACTION], expected < 1)


def test_both_sides_of_glass_let_through_what_all_ways_between_them_do_and_thin_walls_are_alike_from_both():
    """Of smooth sides that reflect R each, (1 - R) / (1 + R) comes through and 2 R / (1 + R) is reflected."""
    cosine = np.array([0.1, 0.5, 0.9], F)
    front, back = (evaluate(glass(), 3, cosine=c) for c in (cosine, -cosine))
    passed = front[:, layout.TRANSPARENCY]
    np.testing.assert_allclose(passed * back[:, layout.TRANSPARENCY], passed / (2 - passed), rtol=1e-5)
    np.testing.assert_allclose(back[:, layout.TRANSPARENCY] + passed * back[:, layout.GLOSSY_F0], 1, rtol=1e-5)
    np.testing.assert_array_equal(back[:, layout.GLOSSY_F0], back[:, layout.GLOSSY_F90])
    within = np.array([ops.from_within(c) for c in -cosine], F)
    wall = evaluate(glass(thin=1), 3, cosine=within)
    np.testing.assert_allclose(wall, evaluate(glass(thin=1), 3, cosine=cosine), rtol=1e-5, atol=2e-6)
    # Of white glass, what is reflected within to and fro leaves by either side.
    np.testing.assert_allclose(wall[:, layout.REFRACTION], (passed := front[:, layout.REFRACTION]) / (2 - passed), rtol=1e-5)


def test_views_from_within_know_whose_they_are():
    emits = tables_of([(ops.VIEWED, 0, sc.CAMERA), (ops.EMISSION_CLOSURE, 1, 0, R, R, R + 1, 0)], [(0,) * 4, (1,) * 4])
    views = np.array([ops.from_within(F(-0.5)), ops.from_within(F(-1)), ops.from_within(ops.reflected_view(F(-0.5)))], F)
    np.testing.assert_array_equal(evaluate(emits, 3, cosine=views)[:, layout.EMISSION], [1, 1, 0])


@pytest.mark.parametrize("rays", [sc.CAMERA, sc.DIFFUSE, sc.GLOSSY, sc.TRANSMISSION, sc.SHADOW, sc.DIFFUSE | sc.GLOSSY])
def test_views_know_the_ray_that_looks(rays):
    emits = tables_of([(ops.VIEWED, 0, rays), (ops.EMISSION_CLOSURE, 1, 0, R, R, R + 1, 0)], [(0,) * 4, (1,) * 4])
    for cosine in np.array([-1, -0.3, 0, 0.6, 1], F):
        views = [ops.specular_view(cosine, kind) for kind in (sc.CAMERA, sc.GLOSSY, sc.TRANSMISSION, sc.SHADOW)] + [
            ops.reflected_view(cosine)
        ]
        views += [ops.from_within(v) for v in views if v < 0]
        met = [bool(rays & kind) for kind in (sc.CAMERA, sc.GLOSSY, sc.TRANSMISSION, sc.SHADOW, sc.DIFFUSE)]
        met = (met + met)[: len(views)]
        np.testing.assert_array_equal(evaluate(emits, len(views), cosine=np.array(views, F))[:, layout.EMISSION], met)


def test_mirrors_and_glass_show_the_albedo_of_the_view():
    cosine = np.array([-1, -0.3, 0.2, 0.9], F)
    for tables in (principled((0.6, 0.3, 0.1), 0.4, 1.5, 0.5, coat=0.8), glass()):
        camera = evaluate(tables, 4, cosine=cosine)
        for kind in (sc.GLOSSY, sc.TRANSMISSION):
            np.testing.assert_allclose(
                evaluate(tables, 4, cosine=np.array([ops.specular_view(c, kind) for c in cosine], F)), camera, atol=2e-6
            )
    within = [
        evaluate(glass(), 1, cosine=np.array([ops.from_within(ops.specular_view(F(-0.5), k))], F)) for k in (sc.CAMERA, sc.TRANSMISSION)
    ]
    np.testing.assert_array_equal(*within)
