"""Shader nodes against Cycles' Diffuse Color, Emission and Combined passes."""

import math

import numpy as np
import pytest

ANGLES = (0.0, 0.6, 1.1, 1.35)


def _shader(node_type, node, **settings):
    def build(tree, end):
        tree.links.new(node(tree, node_type, **settings).outputs[0], end.inputs["Surface"])

    return build


PRINCIPLED = {
    "plain": {},
    "smooth": {"Roughness": 0.0},
    "rough": {"Roughness": 1.0},
    "no specular": {"Specular IOR Level": 0.0},
    "strong specular": {"Specular IOR Level": 1.0, "Roughness": 0.3},
    "tinted": {"Specular Tint": (1, 0.3, 0.2, 1), "Roughness": 0.2},
    "high ior": {"IOR": 2.2, "Roughness": 0.4},
    "low ior": {"IOR": 0.8, "Roughness": 0.4},
    "half metal": {"Metallic": 0.5},
    "metal": {"Metallic": 1.0},
    "transmission": {"Transmission Weight": 0.6},
    "coat": {"Coat Weight": 0.7, "Coat Roughness": 0.2},
    "tinted coat": {"Coat Weight": 0.7, "Coat Tint": (0.9, 0.5, 0.2, 1), "Coat IOR": 1.7},
    "alpha": {"Alpha": 0.3},
    "subsurface": {"Subsurface Weight": 0.4},
    "sheen": {"Sheen Weight": 0.8, "Sheen Roughness": 0.4, "Sheen Tint": (1, 0.7, 0.5, 1)},
    "emission": {"Emission Color": (1, 0.5, 0.25, 1), "Emission Strength": 3.0, "Coat Weight": 0.5, "Sheen Weight": 0.5},
    "all": {"Metallic": 0.2, "Transmission Weight": 0.3, "Coat Weight": 0.4, "Alpha": 0.8, "Roughness": 0.6},
}


def test_principled_layers_as_cycles_at_every_angle(grid, node):
    for name, inputs in PRINCIPLED.items():
        for angle in ANGLES:
            for kind in ("MULTI_GGX", "GGX"):
                settings = {"Base Color": (0.8, 0.5, 0.2, 1), **inputs}
                grid.add(f"{name} {angle} {kind}", _shader("ShaderNodeBsdfPrincipled", node, inputs=settings, distribution=kind), angle)
    middle = slice(28, 36)
    for name, got in grid.compare().items():
        # 0.006 is the quadrature error of the GGX tables at grazing views.
        np.testing.assert_allclose(got.diffuse[middle], got.passes["DiffCol"][middle], atol=0.006, err_msg=name)
        np.testing.assert_allclose(got.emission[middle], got.passes["Emit"][middle], rtol=0.01, atol=0.006, err_msg=name)
        if "transmission" not in name and "all" not in name:
            opacity = 1 - got.transparency[middle, 0]
            np.testing.assert_allclose(opacity, got.passes["Combined"][middle, 3], atol=1e-4, err_msg=name)
