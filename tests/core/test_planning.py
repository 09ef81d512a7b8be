"""What is chosen for a time, an error or neither, and whether it holds."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lumigate.core.passes import GROUPS, UNSEEN, Passes
from lumigate.core.picture import Picture
from lumigate.core.pipeline import render
from lumigate.core.planning import machine as machine_file
from lumigate.core.planning.cost import BASE, MIDDLING, PassCost
from lumigate.core.planning.machine import Machine, cached_machine, look_again
from lumigate.core.planning.planner import AIMING, AIMING_PIXELS, COARSE, COARSE_PIXELS, HIDDEN, LEAST, MOST, QUICKEST, Planner, reduced
from lumigate.core.scene import Camera
from lumigate.core.settings import QUALITIES, QUALITY_ERRORS, RenderSettings

MACHINE = Machine(ray=1e-6, denoiser=0.01, denoiser_pixel=1e-6, threads=2)


def picture(indirect, weight=1.0):
    """A picture of diffuse indirect light alone."""
    zero, one = np.zeros_like(indirect), np.ones_like(indirect)
    return Picture(zero, indirect, zero, one, zero, one, one, one, one, zero, zero[..., 0], weight)


def noisy(variance, seed):
    """A small picture of ones with noise of a variance."""
    return (1 + variance**0.5 * np.random.default_rng(seed).standard_normal((24, 32, 3))).astype(np.float32)


@pytest.mark.parametrize("slow", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("seconds", [1.0, 3.0, 10.0, 100.0])
def test_time_is_used_up_and_not_overrun(seconds, slow):
    # A scene whose passes take .2 s and as much as the first guess for each unit of quality, or some times as long.
    machine = replace(MACHINE, ray=3e-7)
    planner = Planner(RenderSettings(time_budget=seconds).with_defaults(), 40_000, machine, cold=True)
    passes, elapsed, loading = Passes(1), 0.1, 0.4
    quality = planner.first(elapsed)
    while quality is not None:
        assert QUICKEST <= quality <= MOST
        took = loading + slow * (0.2 + 0.45 * (BASE + quality))
        elapsed, loading = elapsed + took, 0.0
        planner.observe(quality, took)
        passes.add(picture(noisy(0.01, 0), quality))
        quality = planner.next(elapsed, passes, None)
    smallest = slow * (0.2 + 0.45 * (BASE + LEAST))
    elapsed += planner.finishing(passes.weight)
    unknown = 0.4 if passes.count == 1 else 0.0  # how much of the first pass went into loading
    assert elapsed > min(0.85 * seconds, seconds - 1.5 * smallest - unknown)
    assert elapsed < 1.1 * seconds or passes.count == 1


def test_larger_scenes_are_foreseen_to_take_longer():
    few, middling, many = (PassCost.of(MACHINE, False, triangles).seconds(100_000, 0.125) for triangles in (32, MIDDLING, 500_000))
    assert few < 0.5 * middling and 1.4 * middling < many
    assert middling == pytest.approx(PassCost.of(MACHINE, False).seconds(100_000, 0.125))
    assert PassCost.of(MACHINE, False, 0).seconds(100_000, 0.125) > 0


def test_what_cannot_fit_is_said():
    planner = Planner(RenderSettings(time_budget=0.1).with_defaults(), 1_000_000, MACHINE)
    assert planner.first(0.05) == QUICKEST
    planner.observe(QUICKEST, 5.0)
    assert planner.next(5.0, Passes(1), None) is None
    assert "fewer pixels" in planner.stats()["reasons"][-1]


def test_fewer_rays_are_taken_before_fewer_pixels():
    """Budgets between the quickest and the smallest usual pass of a whole picture: one pass of as many rays as there is time for."""
    camera, qualities = Camera(np.eye(4), False, (-1, 1, -0.5625, 0.5625), 480, 270, (0, 0, 480, 270), 0.1, 100), []
    for part in (0.5, 0.9, 1.02, 1.2, 3.0):
        planner = Planner(RenderSettings(time_budget=1.0).with_defaults(), 480 * 270, MACHINE)
        quickest, usual = (planner._seconds_of(480 * 270, quality) for quality in (QUICKEST, LEAST))
        planner.settings = replace(planner.settings, time_budget=(1 - part) * quickest + part * usual if part < 2 else part * usual)
        assert (planner.lit_camera(camera, 0.0) is camera) == (planner.lit is None)
        assert planner.lit is None
        qualities.append(planner.first(0.0))
    assert qualities == sorted(qualities) and QUICKEST <= qualities[0] < LEAST and qualities[-1] >= LEAST
    planner = Planner(RenderSettings(time_budget=0.5 * quickest).with_defaults(), 480 * 270, MACHINE)
    small = planner.lit_camera(camera, 0.0)
    assert small.width < 480 and planner.first(0.0) == LEAST  # of pixels that are few enough, no fewer rays


def test_coarse_targets_take_the_quickest_pass_where_its_usual_error_is_small_enough():
    for pixels, target, quality in (
        (1280 * 720, 0.05, QUICKEST),
        (1280 * 720, 0.02, LEAST),
        (480 * 270, 0.05, LEAST),
        (480 * 270, 0.1, QUICKEST),
    ):
        assert Planner(RenderSettings(target_error=target).with_defaults(), pixels, None).first(0.0) == quality


@pytest.mark.parametrize("target", [0.05, 0.02, 0.005])
def test_rounds_go_on_until_the_error_is_met_and_no_further(target):
    planner = Planner(RenderSettings(target_error=target, denoise=False, method="importance-sampling").with_defaults(), 768, None)
    passes = Passes(1)
    quality = planner.first(0.0)
    while quality is not None:
        passes.add(picture(noisy(0.1 / quality, passes.count), quality))
        planner.observe(quality, 1.0)
        quality = planner.next(1.0, passes, None)
    assert passes.count % GROUPS == 0
    true = ((passes.picture.indirect - 1) ** 2).mean()
    assert true < 1.4 * target
    assert true > target / 3  # raw noise falls faster than the denoised error that the planner expects


def test_without_a_goal_one_pass_of_the_numbers_as_they_are():
    planner = Planner(RenderSettings().with_defaults(), 100_000, None)
    assert planner.pilot_passes() == 0
    assert planner.first(0.0) == 1.0
    planner.observe(1.0, 1.0)
    passes = Passes(1)
    passes.add(picture(noisy(0.01, 0)))
    assert planner.next(1.0, passes, None) is None
    assert passes.estimate is None


def flown(error, target=0.01, **settings):
    """A planner whose pilot found an error in a sixteenth of the pixels, and the quality of its first pass."""
    planner = Planner(RenderSettings(target_error=target, **settings).with_defaults(), 32 * AIMING_PIXELS, None)
    assert planner.pilot_passes() == AIMING
    planner.pilot = {"size": [100, 80], "quality": LEAST, "error": error}
    return planner, planner.first(0.0)


def test_pilot_foresees_the_pass_that_meets_a_target():
    found = [flown(error) for error in (0.001, 0.02, 0.03)]
    assert [quality for _, quality in found] == sorted(quality for _, quality in found)
    for planner, quality in found:
        assert planner.foreseen <= 0.01
        planner.observe(quality, 1.0)
        passes = Passes(1)
        passes.add(picture(noisy(0.01, 0), quality))
        assert planner.next(1.0, passes, None) is None
        assert passes.estimate == planner.foreseen
    assert found[0][1] == LEAST
    assert "smaller error than asked for" in found[0][0].reasons[-1]
    # No more than it takes: of a pass one step smaller less is certain.
    assert found[2][0].foreseen > 0.8 * 0.01


def test_where_the_pilot_foresees_much_work_three_passes_tell_their_error():
    (fair, some), (noisier, more) = flown(0.12), flown(0.4)
    assert fair.foreseen is None
    assert noisier.foreseen is None
    assert LEAST < some < more
    assert flown(10.0)[1] == MOST
    fair.observe(some, 1.0)
    passes = Passes(1)
    passes.add(picture(noisy(0.01, 0), some))
    assert fair.next(1.0, passes, None) == some


def test_coarse_targets_need_no_pilot():
    # Fewer pixels have a larger error: of the same target the smaller picture is not sure.
    usual = RenderSettings(target_error=1.2 * COARSE).with_defaults()
    large, small = (Planner(usual, pixels, None) for pixels in (COARSE_PIXELS, COARSE_PIXELS // 2))
    assert large.pilot_passes() == 0 and large.first(0.0) == LEAST
    assert small.pilot_passes() == AIMING
    for other in ({"target_error": 0.02}, {"samples": 1, "gather": 1}, {"denoise": False}, {"method": "instant-radiosity"}):
        assert Planner(replace(usual, **other).with_defaults(), COARSE_PIXELS, None).pilot_passes() == AIMING


def test_a_coarse_picture_with_usual_noise_is_believed():
    planner = Planner(RenderSettings(target_error=1.2 * COARSE).with_defaults(), COARSE_PIXELS, None)
    passes = Passes(1)
    assert planner.first(0.0) == LEAST
    passes.add(picture(noisy(0.3, 0), LEAST))
    assert planner.next(1.0, passes, Flat()) is None
    assert 0 < passes.estimate < 1.2 * COARSE


@pytest.mark.parametrize(
    "pixels, target, noise", [(COARSE_PIXELS, 1.2 * COARSE, 1.8), (768, 0.02, 0.1)], ids=["coarse, of uncommon noise", "small"]
)
def test_without_a_pilot_two_passes_tell_the_error_and_count(pixels, target, noise):
    def made(error):
        denoiser = Flat((3 * error * target / UNSEEN) ** 0.5)
        planner, passes = Planner(RenderSettings(target_error=target).with_defaults(), pixels, None), Passes(1)
        quality = planner.first(0.0)
        while quality is not None and passes.count < 9:
            passes.add(picture(noisy(noise, passes.count), quality))
            planner.observe(quality, 1.0)
            quality = planner.next(1.0, passes, denoiser)
        return [done["quality"] for done in planner.passes], passes.estimate

    for error in (0.1, 1.2):
        qualities, estimate = made(error)
        assert qualities == [LEAST, LEAST]
        assert estimate == pytest.approx(error * target / 2**0.5, abs=max(0.3, noise) * target)
    (first, second, third), estimate = made(2.0)
    assert (first, second) == (LEAST, LEAST)
    assert LEAST < third < 9 * LEAST
    assert 0.8 * target < estimate <= target
    qualities, _ = made(20.0)  # too much for one pass
    assert qualities[:2] == [LEAST, LEAST] and len(qualities) >= 5 and len(set(qualities[2:5])) == 1


class Flat:
    """A denoiser that finds a picture of one value, or one that is tilted: by so much at the left border and as much the other way at the right."""

    available = True

    def __init__(self, tilt: float = 0.0) -> None:
        self.tilt = tilt

    def denoise(self, image, *guides, **options):
        """The mean, tilted."""
        across = np.linspace(-self.tilt, self.tilt, image.shape[1], dtype=np.float32)
        return np.full_like(image, image.mean()) * (1 + across)[:, None]


def test_without_denoising_more_pixels_are_as_noisy_as_few():
    (_, few), (raw, many) = flown(0.018), flown(0.018, denoise=False, method="importance-sampling")
    assert few == LEAST
    # Half as much noise with four times the rays.
    assert raw.foreseen == pytest.approx(HIDDEN * 0.018 * (many / LEAST) ** -0.5)


def test_quick_passes_keep_more_of_their_lights_than_of_their_rays():
    usual = RenderSettings().with_defaults()
    quick, many = usual.scaled(0.25, 1), usual.scaled(4.0, 1)
    assert (quick.samples, quick.gather, quick.direct_samples, quick.reflections, quick.vpls) == (3, 3, 6, 3, 2048)
    assert (many.samples, many.gather, many.direct_samples, many.reflections, many.vpls) == (32, 32, 64, 24, 8192)
    quickest = [replace(usual, direct_samples=n).scaled(0.02, 1).direct_samples for n in (1, 8, 16)]
    assert quickest == [1, 2, 2]
    # Of a method that sends rays to each of them the lights are what takes time.
    radiosity = RenderSettings(method="instant-radiosity").with_defaults()
    assert (radiosity.scaled(0.25, 1).vpls, radiosity.scaled(4.0, 1).vpls) == (1448, 8192)


def test_the_denoiser_has_more_time_where_there_are_more_rays():
    planner = Planner(RenderSettings(time_budget=10).with_defaults(), 100_000, MACHINE)
    assert planner.finishing(0.5) < planner.finishing(1.0) < planner.finishing(2.0)
    assert Planner(RenderSettings(time_budget=10, denoise=False).with_defaults(), 100_000, MACHINE).finishing(2.0) == 0


def test_time_that_no_pass_can_use_is_the_denoisers():
    planner = Planner(RenderSettings(time_budget=3).with_defaults(), 100_000, MACHINE)
    chosen = [planner.denoising_quality(0.5, elapsed, "fast") for elapsed in (2.0, 2.75, 2.8, 2.9, 3.1)]
    seconds = [planner.denoising_seconds(quality) for quality in ("fast", "balanced", "high")]
    np.testing.assert_allclose(seconds, MACHINE.denoising(100_000, 2) * np.array([0.8, 1.1, 1.8]))
    assert chosen == ["high", "balanced", "fast", "fast", "fast"]
    assert planner.denoising_quality(0.5, 2.9, "high") == "high"
    # Without a budget the clock has no say.
    assert Planner(RenderSettings().with_defaults(), 100_000, None).denoising_quality(0.5, 0.0, "fast") == "fast"


def test_cost_follows_what_was_seen():
    cost = PassCost(np.array([0.5, 0.2, 1e-5]))
    for k, quality in enumerate((0.25, 0.5, 2.0)):
        cost.observe(10_000, quality, 0.9 * (k == 0) + 0.4 + 5e-5 * 10_000 * (BASE + quality))
    assert cost.seconds(10_000, 4.0) == pytest.approx(2.4 + 0.5 * BASE, rel=0.1)
    assert cost.quality(10_000, cost.seconds(10_000, 1.5)) == pytest.approx(1.5)


def test_a_pilot_alone_counts_in_part():
    """In few pixels a pass takes longer than the machine tells; a picture of many need not."""

    def foreseen(slower, **kind):
        cost = PassCost(np.array([0.0, 0.2, 1e-5]))
        usual = cost.seconds(200_000, 1.0)
        cost.observe(8000, 0.25, slower * cost.seconds(8000, 0.25), **kind)
        told = cost.seconds(200_000, 1.0) / usual
        cost.observe(200_000, 1.0, 3 * usual)
        assert cost.seconds(200_000, 1.0) == pytest.approx(3 * usual, rel=0.1)
        return told

    assert foreseen(2.0) == pytest.approx(2, rel=0.05)
    assert foreseen(0.5) == pytest.approx(0.5, rel=0.05)
    assert 1.2 < foreseen(2.0, pilot=True) < 1.6
    assert 0.5 < foreseen(0.5, pilot=True) < 0.8


def test_machine_is_measured_once(tmp_path, monkeypatch):
    first = cached_machine(1, tmp_path)
    assert 0 < first.ray < 1e-3 and first.denoiser_pixel > 0 and first.looks == 1
    assert cached_machine(1, tmp_path) == first
    (path,) = tmp_path.glob("machine*.json")
    kept = json.loads(path.read_text())
    again = Machine(1e-4, 0.2, 3e-7, 1)
    monkeypatch.setattr(machine_file, "measure", lambda threads: again)
    for spoiled in ("{", json.dumps(kept | {"ray": 1.0, "key": {"version": 0}}), json.dumps(kept | {"colour": 1})):
        path.write_text(spoiled)
        assert cached_machine(1, tmp_path) == again


def test_least_counts_of_three_looks_at_a_machine(tmp_path, monkeypatch):
    seen = iter([Machine(3.0, 0.2, 1.0, 2), Machine(1.0, 0.4, 2.0, 2), Machine(2.0, 0.1, 3.0, 2)])
    monkeypatch.setattr(machine_file, "measure", lambda threads: next(seen))
    machine = cached_machine(2, tmp_path)
    for _ in range(3):  # the last one is one too many
        machine = look_again(machine, tmp_path)
    assert machine == Machine(1.0, 0.1, 1.0, 2, looks=3) == cached_machine(2, tmp_path)


def test_a_machine_that_was_busy_when_it_was_measured_is_measured_again(sphere, tmp_path, monkeypatch):
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path))
    for denoiser, looks in ((100.0, 2), (0.0, 1)):
        file = tmp_path / "machine-1.json"
        file.unlink(missing_ok=True)
        monkeypatch.setattr(machine_file, "measure", lambda threads, least=denoiser: Machine(1e-6, least, 1e-9, threads))
        cached_machine(1)
        render(sphere, RenderSettings(vpls=64, time_budget=0.1, threads=1))
        assert json.loads(file.read_text())["looks"] == looks


def test_the_numbers_of_a_preset_give_way_to_its_error():
    preset = RenderSettings(quality="final", **QUALITIES["final"]).with_defaults()
    assert (preset.target_error, preset.samples, preset.vpls) == (QUALITY_ERRORS["final"], 8, 4096)
    own = RenderSettings(quality="final", samples=5).with_defaults()
    assert (own.target_error, own.samples) == (QUALITY_ERRORS["final"], 5)


@pytest.mark.parametrize("border", [(0, 0, 640, 360), (100, 50, 101, 52), (639, 359, 640, 360)])
def test_reduced_camera_keeps_the_view(build, border):
    camera = replace(build.camera(width=640, height=360), border=border)
    small = reduced(camera, 5.0)
    assert (small.width, small.height) == (128, 72)
    assert small.window == camera.window
    x0, y0, x1, y1 = small.border
    assert 0 <= x0 < x1 <= 128 and 0 <= y0 < y1 <= 72


@pytest.fixture(scope="module")
def sphere(build):
    """A closed sphere, radiance 1 W/m^2/sr, albedo 0.5, seen from its middle."""
    return build.scene(build.geometry(*build.icosphere(3)), build.materials((0.5, 1.0)), camera=build.camera(width=24, height=24))


def test_a_render_meets_its_target_the_same_on_any_machine(sphere):
    settings = RenderSettings(vpls=256, target_error=0.003)
    result, again = (render(sphere, replace(settings, threads=threads)) for threads in (1, 2))
    assert result.stats["error_estimate"] <= 0.0035
    assert result.stats["passes"] == AIMING
    np.testing.assert_array_equal(result.layers["Albedo"], again.layers["Albedo"])
    assert again.stats["passes"] == result.stats["passes"]
    exact = np.pi * sum(0.5**k for k in range(1, 5))
    assert ((result.layers["Irradiance"] / exact - 1) ** 2).mean() < 0.0045


def test_a_budget_is_planned_and_told(sphere, tmp_path, monkeypatch):
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path))
    result = render(sphere, RenderSettings(vpls=64, time_budget=3.0))
    auto = result.stats["auto"]
    assert result.stats["passes"] == len(auto["passes"]) >= 1
    assert result.stats["error_estimate"] is None
    assert auto["goal"] == {"time_budget": 3.0} and auto["reasons"] and auto["method"] == "importance-sampling"
    json.dumps(auto, allow_nan=False)


def test_names_of_qualities_are_target_errors(sphere):
    result = render(sphere, RenderSettings(vpls=64, quality="preview"))
    assert result.stats["auto"]["goal"] == {"target_error": QUALITY_ERRORS["preview"]}
    named = render(sphere, RenderSettings(vpls=64, quality="preview", method="importance-sampling"))
    assert named.stats["passes"] == 1 and "auto" not in named.stats
