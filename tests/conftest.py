"""What all tests share."""

import os
import sys

import pytest

_status = 0


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(exitstatus):
    """Keep the status for `pytest_unconfigure`."""
    global _status
    _status = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure():
    """Leave without bpy 4.5's static destructors.

    They wait for ever on its sound thread when the interpreter has kept a reference to bpy, and pytest
    keeps many (gone in Blender 5.0).
    """
    if "bpy" in sys.modules and sys.modules["bpy"].app.version < (5, 0):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(_status)
