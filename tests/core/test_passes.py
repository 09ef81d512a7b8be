"""How well the passes' own estimate of their error holds."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core.passes import UNSEEN, UNSEEN_NOISE, Passes, denoising_quality, has_few_rays
from lumigate.core.picture import Picture
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings


def picture(indirect, weight=1.0):
    """A picture of diffuse indirect light alone."""
    zero = np.zeros_like(indirect)
    one = np.ones_like(indirect)
    return Picture(zero, indirect, zero, one, zero, one, one, one, one, zero, zero[..., 0], weight)


def noisy(level, seed, shape=(48, 64, 3)):
    """One over the picture, and noise of a relative deviation."""
    return (1 + level * np.random.default_rng(seed).standard_normal(shape)).astype(np.float32)


class Tilted:
    """A denoiser that is wrong every time in the same way, which the difference of two of its pictures would not show."""

    available = True
    tilt = np.linspace(0.8, 1.2, 64, dtype=np.float32)[None, :, None]

    def denoise(self, image, *guides, **options):
        """A gradient without any noise, whatever comes in."""
        return self.tilt * np.full_like(image, image.mean())


def passes_of(*pictures):
    """Passes with one thread."""
    passes = Passes(1)
    for one in pictures:
        passes.add(one)
    return passes


def test_pictures_are_averaged_by_their_weights():
    passes = passes_of(picture(np.full((2, 2, 3), 1.0, np.float32), 1.0), picture(np.full((2, 2, 3), 4.0, np.float32), 3.0))
    np.testing.assert_allclose(passes.picture.indirect, 3.25)
    assert passes.weight == passes.picture.weight == 4


def test_estimate_needs_three_passes():
    assert np.isnan(passes_of(picture(noisy(0.1, 1)), picture(noisy(0.1, 2))).error(None))


def test_estimate_is_the_error_of_the_mean():
    # Noise of .3 in each of nine passes: the mean's squared error is .09 / 9.
    assert passes_of(*(picture(noisy(0.3, k)) for k in range(9))).error(None) == pytest.approx(0.09 / 9, rel=0.1)


def test_estimate_sees_what_the_denoiser_does_wrong():
    wrong = ((Tilted.tilt - 1) ** 2).mean() * UNSEEN / 3**0.5
    assert passes_of(*(picture(noisy(0.25, k)) for k in range(3))).error(Tilted()) == pytest.approx(wrong, rel=0.1)


def test_two_passes_tell_the_error_of_one():
    # Noise of .1 in each of two passes, as it is; a denoiser's error whatever the noise.
    two = passes_of(*(picture(noisy(0.1, k)) for k in range(2)))
    assert two.error_of_one(None) == pytest.approx(0.01, rel=0.1)
    wrong = ((Tilted.tilt - 1) ** 2).mean() * UNSEEN
    assert two.error_of_one(Tilted()) == pytest.approx(wrong, rel=0.1)


def test_more_noise_foretells_a_larger_error():
    quiet, loud = (passes_of(picture(noisy(level, 1))).error_by_noise(Tilted()) for level in (0.3, 0.6))
    assert loud > 1.5 * quiet > 0


def test_what_is_denoised_for_the_estimate_is_not_denoised_again():
    class Counting(Tilted):
        calls = 0

        def denoise(self, *arguments, **options):
            """As `Tilted`."""
            self.calls += 1
            return super().denoise(*arguments, **options)

    denoiser, passes = Counting(), passes_of(picture(noisy(0.3, 1)))
    passes.error_by_noise(denoiser)
    told, denoiser.calls = denoiser.calls, 0
    again = passes.picture.denoised(denoiser, 1, quality="fast", clean=passes.clean)
    assert told > 0 == denoiser.calls
    np.testing.assert_array_equal(again.indirect, passes.picture.denoised(denoiser, 1, quality="fast").indirect)
    passes.add(picture(noisy(0.3, 2)))
    assert passes.clean is None


def test_what_a_denoiser_would_only_make_worse_is_left_as_it_is():
    quiet, loud = (passes_of(*(picture(noisy(level, k)) for k in range(3))) for level in (0.01, 0.5))
    assert quiet.error(Tilted()) == pytest.approx(0.01**2 / 3, rel=0.2)
    assert quiet.as_it_is
    assert loud.error(Tilted()) < 0.5**2 / 3
    assert not loud.as_it_is
    assert loud.error(Tilted(), 0.3) > 0.5**2 / 3
    assert loud.as_it_is


def test_a_black_picture_has_no_error():
    assert passes_of(*[picture(np.zeros((4, 4, 3), np.float32))] * 3).error(None) == 0


@pytest.fixture(scope="module")
def sphere(build):
    """A closed sphere, radiance 1 W/m^2/sr, albedo 0.5, seen from its middle."""
    return build.scene(build.geometry(*build.icosphere(3)), build.materials((0.5, 1.0)), camera=build.camera(width=24, height=24))


def test_only_what_the_wanted_layers_need_is_computed(sphere):
    result = render(sphere, RenderSettings(vpls=64, layers=("DiffuseIndirect",)))
    assert set(result.layers) == {"DiffuseIndirect"}
    assert not {"direct", "glossy"} & set(result.stats["seconds"])
    direct = render(sphere, RenderSettings(vpls=64, layers=("Direct",)))
    assert "indirect" not in direct.stats["seconds"]
    shapes = render(sphere, RenderSettings(vpls=64, layers=("Depth", "Albedo")))
    assert not {"cache", "direct", "glossy", "vpls", "indirect"} & set(shapes.stats["seconds"])


def test_light_whose_error_is_met_is_not_denoised(sphere):
    """All of the sphere sends the same light, and many rays leave next to no noise in it."""
    settings = RenderSettings(method="importance-sampling", target_error=0.01, samples=128, gather=128, layers=("DiffuseIndirect",))
    met = render(sphere, settings)
    noisy = render(sphere, replace(settings, samples=1, gather=1))
    assert [line["reason"][:27] for line in met.stats["skipped"] if line["stage"] == "denoise"] == ["the indirect light's relMSE"]
    assert met.stats["error_estimate"] <= UNSEEN_NOISE
    assert not [line for line in noisy.stats["skipped"] if line["stage"] == "denoise"]
    light = met.layers["DiffuseIndirect"].astype(float)
    assert ((light - light.mean()) ** 2).mean() / light.mean() ** 2 < 4 * UNSEEN_NOISE


def test_smooth_light_is_left_to_its_method():
    clouded = replace(picture(noisy(0.3, 1)), direct=noisy(0.3, 2), glossy_indirect=noisy(0.3, 3))
    clean, rough = replace(clouded, smooth=clouded.diffuse_indirect).denoised(Tilted(), 1), clouded.denoised(Tilted(), 1)
    assert np.array_equal(clean.diffuse_indirect, clouded.diffuse_indirect)
    by_glass = replace(clouded, smooth=np.float32(0.75) * clouded.diffuse_indirect).denoised(Tilted(), 1).diffuse_indirect
    assert np.all(by_glass >= np.float32(0.75) * clouded.diffuse_indirect) and not np.array_equal(by_glass, clouded.diffuse_indirect)
    assert not np.array_equal(rough.diffuse_indirect, clouded.diffuse_indirect)
    for name in ("direct", "glossy_indirect"):
        assert np.array_equal(getattr(clean, name), getattr(rough, name))
        assert not np.array_equal(getattr(clean, name), getattr(clouded, name))


def test_the_denoiser_works_the_longer_the_more_rays_there_were():
    settings = RenderSettings(method="importance-sampling").with_defaults()  # the default is balanced, whatever its numbers
    assert [denoising_quality(settings, weight) for weight in (0.25, 1, 4)] == ["fast", "balanced", "high"]
    assert [has_few_rays(settings, weight) for weight in (0.25, 1, 4)] == [True, False, False]
    assert [denoising_quality(settings, weight, least="balanced") for weight in (0.25, 4)] == ["balanced", "high"]
    assert denoising_quality(replace(settings, method="fuzzy-clustering"), 4, least="high") == "fast"
    assert denoising_quality(replace(settings, method="instant-radiosity"), 1) == "balanced"


class Recorder:
    """A denoiser that leaves everything as it is, and notes the guides that it was given."""

    available = True

    def __init__(self):
        self.guides, self.filtered = [], []

    def denoise(self, image, albedo, normal, **options):
        self.guides.append((albedo, options.get("clean_aux", False), options["quality"]))
        return image

    def prefilter(self, kind, guide, **options):
        self.filtered.append(guide.shape[:2])
        return np.zeros_like(guide)


class Blurring(Recorder):
    """A denoiser that makes pictures even."""

    def denoise(self, image, albedo, normal, **options):
        return np.broadcast_to(image.mean(axis=(0, 1)), image.shape).astype(np.float32)


def test_glossy_light_is_not_smeared_onto_what_is_matt():
    """A board of metal and matt squares of a pixel, whose guides are alike."""
    one, zero = np.ones((40, 60, 3), np.float32), np.zeros((40, 60, 3), np.float32)
    metal = (np.indices(one.shape[:2]).sum(axis=0) % 2)[..., None] * one
    picture = Picture(zero, one, 2 * metal, zero, one - metal, one, one, one, one, zero, zero[..., 0], glossy_albedo=metal)
    light = picture.denoised(Blurring(), 1).glossy_indirect
    assert not light[metal == 0].any()
    np.testing.assert_allclose(light[4:-4, 4:-4][metal[4:-4, 4:-4] > 0], 2, rtol=0.1)
    assert light.mean() == pytest.approx(1, rel=1e-4)


@pytest.mark.parametrize("sharp", [False, True])
def test_direct_light_is_not_smeared_onto_lamps(sharp):
    """Bulbs of a pixel before a wall."""
    one, zero = np.ones((40, 60, 3), np.float32), np.zeros((40, 60, 3), np.float32)
    wall = one.copy()
    wall[2::5, 2::5] = 0
    parts = dict(sharp=wall, unshadowed=wall, doubt=wall) if sharp else {}
    picture = Picture(2 * wall, zero, zero, wall, one - wall, one, wall, one, wall, zero, zero[..., 0], glossy_albedo=zero, **parts)
    found = picture.denoised(Blurring(), 1)
    assert not found.direct[wall == 0].any()
    np.testing.assert_allclose(found.direct[4:-4, 4:-4][wall[4:-4, 4:-4] > 0], 2, rtol=0.1)
    assert found.direct.mean() == pytest.approx(2 * wall.mean(), rel=1e-4)
    assert not sharp or not found.sharp[wall == 0].any()


def mirrored(rows, columns):
    """A picture in which rays from lobes met an albedo of 1/2 in a mirror of so many pixels, where it has none itself."""
    one, zero = np.ones((100, 100, 3), np.float32), np.zeros((100, 100, 3), np.float32)
    albedo, shown = one.copy(), zero.copy()
    albedo[40 : 40 + rows, 40 : 40 + columns] = 0
    shown[40 : 40 + rows, 40 : 40 + columns] = 0.5
    return Picture(one, one, one, albedo, zero, one, albedo, one, albedo, zero, zero[..., 0], mirrored_albedo=shown)


@pytest.mark.parametrize(
    ("rows", "quality", "clean", "filtered"),
    [
        (5, "balanced", True, []),  # half a hundredth of the pixels
        (20, "fast", False, []),
        (20, "balanced", True, [(52, 42)]),
        (50, "fast", True, [(76, 42)]),
    ],
)
def test_what_mirrors_show_guides_reflections_alone(rows, quality, clean, filtered):
    recorder = Recorder()
    picture = mirrored(rows, 10)
    picture.denoised(recorder, 1, quality=quality)
    (ratio, _, _), (diffuse, _, _), (glossy, told, _), (direct, _, _) = recorder.guides
    assert ratio is None and np.array_equal(diffuse, picture.albedo) and np.array_equal(direct, picture.albedo)
    assert told == clean and recorder.filtered == filtered
    assert np.array_equal(glossy, picture.albedo if filtered else picture.albedo + picture.mirrored_albedo)
