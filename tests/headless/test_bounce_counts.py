"""Diffuse bounces against Cycles, which counts the first by the lobe that it draws a direction from, whatever the path then finds.

The fewer bounces, the more that decides: of light that a rough varnish reflects half has one bounce less than that of a mirror.
"""

import hashlib
import math
from pathlib import Path

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.cache import cached_halves

from .test_direct_light import lamp, look, material, quad

SIZE = (36, 20)
SEEDS = 3


def closed_room(**inputs):
    """A closed room of one material, lit by a lamp below its ceiling that the camera does not see."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    wall = material("Wall", **inputs)
    corners = [(x, y, z) for x in (-2, 2) for y in (-2, 2) for z in (0, 2.6)]
    for face in [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]:
        quad(scene, [corners[k] for k in face], wall)
    lamp(scene, "AREA", (0, 0, 2.5), energy=50.0, size=0.5)
    look(scene, (-1.7, -1.7, 1.5), (math.radians(84), 0, math.radians(-45)), lens=20.0)
    return scene


MATERIALS = {
    "varnish": {"Roughness": 0.5, "Base_Color": (0.75, 0.6, 0.5, 1)},
    "rough": {"Roughness": 1.0, "Base_Color": (0.75, 0.6, 0.5, 1)},
    "metal": {"Roughness": 0.4, "Metallic": 0.82, "Base_Color": (0.5, 0.5, 0.5, 1)},
    "polish": {"Roughness": 0.2, "Base_Color": (0.75, 0.6, 0.5, 1)},
}


@pytest.mark.parametrize(("surface", "bounces"), [*((surface, 1) for surface in MATERIALS), ("varnish", 4), ("metal", 4)])
def test_a_first_bounce_counts_by_the_lobe_that_it_is_drawn_from(surface, bounces):
    scene = closed_room(**MATERIALS[surface])
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "surface": surface}
    halves = cached_halves(scene, identity, size=SIZE, spp=384, bounces=bounces, seed=1)
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(seed=seed, bounces=bounces)).layers for seed in range(SEEDS)]
    # Of what gather rays that follow metal find beyond the last bounce of virtual lights, 2 % were lost.
    for name, tolerance in (("GlossyIndirect", 0.03), ("DiffuseIndirect", 0.012 if surface == "metal" else 0.02)):
        expected, mine = ([layers[name].mean(dtype=float) for layers in some] for some in (halves, ours))
        noise = abs(expected[0] - expected[1]) / 2 + np.std(mine, ddof=1) / math.sqrt(SEEDS)
        assert np.mean(mine) == pytest.approx(np.mean(expected), abs=tolerance * np.mean(expected) + 2 * noise), name
