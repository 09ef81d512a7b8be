"""Two parts of a render at once: what they count, who hears of errors, and who of being cancelled."""

from threading import Event, get_ident

import pytest

from lumigate.core.scene import Skipped
from lumigate.core.stages import Run, side_by_side
from lumigate.core.threads import Cancelled

LONG = 30  # s: more than any of this takes


def part(name, rays):
    def work(run):
        with run.stage(name):
            run.rays["shadow"] += rays
        run.skip("glossy", "none")
        run.warn(f"{rays} rays")
        run.leave_out("pixels", 1, 2)
        run.vpls += 3
        return name, get_ident()

    return work


@pytest.mark.parametrize("threads", [1, 2])
def test_all_counts_are_one_run_s(threads):
    run = Run(None)
    run.rays["shadow"] = 1
    (a, here), (b, there) = side_by_side(run, threads, part("vpls", 10), part("direct", 100))
    assert (a, b) == ("vpls", "direct")
    assert (here == there) == (threads == 1)
    assert run.rays == {"primary": 0, "light": 0, "shadow": 111}
    assert set(run.seconds) == {"vpls", "direct", "jit"}
    assert run.skipped == [Skipped("glossy", "none")] and run.warnings == ["10 rays"]
    assert run.left_out == {"pixels": (2, 4)} and run.vpls == 6


def test_an_error_aside_is_raised_here():
    def fails(run):
        raise MemoryError("no room")

    with pytest.raises(MemoryError, match="no room"):
        side_by_side(Run(None), 2, part("vpls", 1), fails)


@pytest.mark.parametrize("who", ["here", "aside"])
def test_both_end_when_cancelled(who):
    begun, ended, asked = Event(), Event(), []

    def progress(stage, done):
        asked.append(stage)
        return not begun.is_set()

    def aside(run):
        with run.stage("direct") as tick:
            begun.set()
            while tick(0.5):
                assert not ended.wait(0.001)
            ended.set()
            raise Cancelled

    def here(run):
        if who == "here":
            assert begun.wait(LONG)
            with run.stage("vpls"):
                pass

    with pytest.raises(Cancelled):
        side_by_side(Run(progress), 2, here, aside)
    assert ended.is_set()
    assert asked[-1] == ("vpls" if who == "here" else "direct")
