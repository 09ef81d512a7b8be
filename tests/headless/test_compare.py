"""`lumigate compare` with a second half of the reference, and with another picture."""

import json

import numpy as np
import pytest

from lumigate.core.layers import Layers, write_exr
from lumigate.headless.cli import main

SHAPE = (48, 64, 3)


@pytest.fixture
def files(tmp_path):
    """Pictures of one truth with relative noise: two halves of a reference, one of little and one of more noise."""

    def write(seed, name, level):
        noise = np.random.default_rng(seed).standard_normal(SHAPE)
        return str(write_exr(tmp_path / f"{name}.exr", Layers({"Indirect": 1 + level * noise})))

    names = (("half0", 0.2), ("half1", 0.2), ("good", 0.1), ("bad", 0.2))
    return [write(seed, name, level) for seed, (name, level) in enumerate(names)]


def test_errors_are_net_of_the_reference_noise(files, tmp_path, capfd):
    half0, half1, good, _ = files
    assert main(["compare", good, half0, "--half", half1, "--json", str(tmp_path / "c.json")]) == 0
    figures = json.loads((tmp_path / "c.json").read_text())
    # The denominators' own noise makes both a little larger.
    assert figures["relmse"] == pytest.approx(0.01, rel=0.5)
    assert figures["reference_noise"] == pytest.approx(0.02, rel=0.2)
    assert figures["half"] == half1


def test_the_better_of_two_pictures_is_named(files, tmp_path, capfd):
    half0, half1, good, bad = files
    assert main(["compare", bad, half0, "--half", half1, "--against", good, "--json", str(tmp_path / "c.json")]) == 0
    found = json.loads((tmp_path / "c.json").read_text())["significance"]
    assert found["verdict"] == "other"
    assert -0.05 < found["low"] < found["high"] < -0.02
    assert "good.exr is better than bad.exr" in capfd.readouterr().out


def test_a_picture_is_not_better_than_itself(files, capfd):
    assert main(["compare", files[2], files[0], "--against", files[2]]) == 0
    assert "cannot be told apart" in capfd.readouterr().out
