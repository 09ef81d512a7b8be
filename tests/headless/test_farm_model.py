"""The model of a film shot: what it must hold whatever the constants are."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.headless.farm.model import Shot, on_paper, scaling, simulate

SHOT = Shot(frames=200, triangles=1e6)


@pytest.mark.parametrize("workers", [1, 4])
def test_equal_frames_take_the_time_on_paper(workers):
    parts = on_paper(SHOT, workers)
    assert simulate(replace(SHOT, spread=0.0), workers) == pytest.approx(parts["frames"] + parts["history"] + SHOT.start_seconds, rel=0.1)


def test_a_worker_warms_up_once_for_its_segment():
    even = replace(SHOT, spread=0.0)
    for workers in (1, 2, 5):
        more = simulate(even, workers) - simulate(replace(even, warm_up=0.0), workers)
        assert more == pytest.approx(SHOT.warm_up * SHOT.frame_seconds)


def test_what_one_worker_leaves_another_does():
    """With frames that differ as much as these, four segments that nobody touched would be done 3.1 times as fast as one."""
    uneven = replace(SHOT, frames=2000, spread=2.0)
    assert np.median([simulate(uneven, 1, seed) / simulate(uneven, 4, seed) for seed in range(5)]) > 3.5


def test_more_workers_are_never_slower_than_the_link():
    rows = scaling(SHOT, (1, 2, 4, 8))
    assert [row["speedup"] for row in rows] == sorted(row["speedup"] for row in rows)
    assert all(row["efficiency"] <= 1.05 for row in rows)
    narrow = replace(SHOT, link=1e8)
    assert simulate(narrow, 25) >= 0.99 * narrow.frames * narrow.picture_seconds


def test_workers_beyond_the_parts_do_nothing():
    assert simulate(SHOT, 25) == simulate(SHOT, 1000)
