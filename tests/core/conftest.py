"""Small scenes made of arrays, for all tests of the core."""

import pytest

from lumigate.headless.stress import arrays


@pytest.fixture(scope="session")
def build():
    """The builders of `headless.stress.arrays`, by name."""
    return arrays
