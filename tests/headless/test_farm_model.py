"""The model of a film shot: what it must hold whatever the constants are."""

from dataclasses import replace

import pytest

from lumigate.headless.farm.model import Shot, on_paper, scaling, simulate

SHOT = Shot(frames=200, triangles=1e6)


def test_one_worker_takes_the_time_on_paper():
    parts = on_paper(SHOT, 1)
    assert simulate(replace(SHOT, spread=0.0), 1) == pytest.approx(parts["frames"] + parts["history"] + SHOT.start_seconds, rel=0.1)


def test_more_workers_are_never_slower_than_the_link():
    rows = scaling(SHOT, (1, 2, 4, 8))
    assert [row["speedup"] for row in rows] == sorted(row["speedup"] for row in rows)
    assert all(row["efficiency"] <= 1.05 for row in rows)
    narrow = replace(SHOT, link=1e8)
    assert simulate(narrow, 25) >= 0.99 * narrow.frames * narrow.picture_seconds


def test_workers_beyond_the_parts_do_nothing():
    assert simulate(SHOT, 25) == simulate(SHOT, 1000)
