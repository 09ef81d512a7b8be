"""Memory is estimated before it is taken, and refused where there is not enough."""

from dataclasses import replace

import pytest

from lumigate.core import memory
from lumigate.core.errors import SceneError
from lumigate.core.pipeline import render
from lumigate.headless.stress import rooms


def test_the_estimate_grows_with_what_is_asked_for():
    small = memory.estimate(rooms.room(), rooms.SETTINGS)
    assert memory.estimate(rooms.room(size=(4000, 3000)), rooms.SETTINGS) > small + 12e6 * 500
    assert memory.estimate(rooms.room(), replace(rooms.SETTINGS, vpls=1_000_000)) > small + 0.9e9


def test_what_cannot_fit_is_refused_in_a_line(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 100 << 20)
    with pytest.raises(SceneError, match=r"0\.1 GiB are free: give it a smaller size"):
        render(rooms.room(), rooms.SETTINGS)


def test_a_system_that_does_not_tell_refuses_nothing(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: None)
    memory.check_memory(rooms.room(size=(60_000, 60_000)), rooms.SETTINGS)


def test_limits_of_the_process_count(monkeypatch):
    resource = pytest.importorskip("resource")
    free = memory.available()
    monkeypatch.setattr(resource, "getrlimit", lambda which: (1 << 20, 1 << 20))
    assert memory.available() == 0 < free
