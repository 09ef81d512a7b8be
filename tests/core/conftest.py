"""Small scenes made of arrays, for all tests of the core."""

import pytest

from lumigate.core.planning import machine
from lumigate.headless.stress import arrays


@pytest.fixture(scope="session")
def build():
    """The builders of `headless.stress.arrays`, by name."""
    return arrays


@pytest.fixture
def no_time(tmp_path, monkeypatch):
    """Makes the machine out to be so slow that no budget of seconds lets a whole picture be lit."""
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path))
    monkeypatch.setattr(machine, "measure", lambda threads: machine.Machine(ray=1e-4, denoiser=0.01, denoiser_pixel=1e-6, threads=threads))
