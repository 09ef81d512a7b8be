"""Procedural textures against Cycles: each plane emits the output of one node."""

import numpy as np

from lumigate.core.surfaces.noise import FRACTAL_KINDS
from lumigate.core.surfaces.procedural import GRADIENT_KINDS
from lumigate.core.surfaces.voronoi import FEATURES, METRICS


def _place(tree):
    """Coordinates on both sides of zero in all three axes."""
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Location"].default_value = (-0.4, -0.61, 0.3)
    mapping.inputs["Rotation"].default_value = (0.3, 0.4, 0.5)
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Object"], mapping.inputs["Vector"])
    return mapping.outputs[0]


def _weight(tree):
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = "Weight"
    return node.outputs["Fac"]


def check(grid, atol=1e-3, outliers=0.0):
    for name, got in grid.compare().items():
        off = np.abs(got.emission - np.maximum(got.passes["Emit"], 0)).max(1) > atol
        assert off.mean() <= outliers, (name, got.emission[off][:3], got.passes["Emit"][off][:3])


def test_checker_and_gradient(grid):
    for output in ("Color", "Fac"):
        inputs = {"Vector": _place, "Color1": (0.9, 0.2, 0.1, 1), "Color2": (0.1, 0.3, 0.8, 1), "Scale": 4.3}
        grid.emit(f"checker {output}", "ShaderNodeTexChecker", output=output, inputs=inputs)
    for kind in GRADIENT_KINDS:
        grid.emit(f"gradient {kind}", "ShaderNodeTexGradient", gradient_type=kind, inputs={"Vector": _place})
    grid.emit("generated", "ShaderNodeTexGradient")
    check(grid)


def test_noise(grid):
    for dimensions in ("1D", "2D", "3D", "4D"):
        for kind in FRACTAL_KINDS:
            inputs = {"Vector": _place, "Scale": 3.0, "Detail": 2.4, "Roughness": 0.6, "Lacunarity": 2.2, "Distortion": 0.5}
            if dimensions in ("1D", "4D"):
                inputs["W"] = _weight
            if kind not in ("MULTIFRACTAL", "FBM"):
                inputs["Offset"] = 0.4
            if kind in ("HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL"):
                inputs["Gain"] = 1.3
            for output in ("Color", "Fac"):
                settings = {"noise_dimensions": dimensions, "noise_type": kind, "inputs": inputs}
                grid.emit(f"{dimensions} {kind} {output}", "ShaderNodeTexNoise", output=output, **settings)
        plain = {"Vector": _place, "Scale": 5.0}
        for normalize in (False, True):
            settings = {"noise_dimensions": dimensions, "normalize": normalize, "inputs": plain}
            grid.emit(f"{dimensions} normalize {normalize}", "ShaderNodeTexNoise", **settings)
    check(grid)


def test_white_noise(grid):
    """The hash takes every bit of a coordinate: only steps that both sides round alike can be compared."""

    def snapped(tree):
        snap = tree.nodes.new("ShaderNodeVectorMath")
        snap.operation = "FLOOR"
        scale = tree.nodes.new("ShaderNodeVectorMath")
        scale.operation = "SCALE"
        scale.inputs["Scale"].default_value = 3.7
        tree.links.new(_place(tree), scale.inputs[0])
        tree.links.new(scale.outputs[0], snap.inputs[0])
        return snap.outputs[0]

    for dimensions in ("1D", "2D", "3D", "4D"):
        for output in ("Color", "Value"):
            inputs = {"Vector": snapped, "W": 2.0}
            grid.emit(f"{dimensions} {output}", "ShaderNodeTexWhiteNoise", output=output, noise_dimensions=dimensions, inputs=inputs)
    grid.emit("everywhere alike", "ShaderNodeTexWhiteNoise", output="Color")
    check(grid)


def test_wave(grid):
    for kind in ("BANDS", "RINGS"):
        for direction in ("X", "Y", "Z", "DIAGONAL" if kind == "BANDS" else "SPHERICAL"):
            for profile in ("SIN", "SAW", "TRI"):
                settings = {"wave_type": kind, "wave_profile": profile, f"{kind.lower()}_direction": direction}
                for distortion in (0.0, 1.5):
                    inputs = {"Vector": _place, "Scale": 1.3, "Distortion": distortion, "Detail": 1.5, "Phase Offset": 0.7}
                    grid.emit(f"{kind} {direction} {profile} {distortion}", "ShaderNodeTexWave", inputs=inputs, **settings)
    # A saw jumps, and a point on the jump may fall on either side.
    check(grid, atol=3e-3, outliers=0.02)


def test_magic(grid):
    for depth in range(11):
        inputs = {"Vector": _place, "Scale": 2.3, "Distortion": 1.4}
        grid.emit(f"magic {depth}", "ShaderNodeTexMagic", turbulence_depth=depth, inputs=inputs)
    grid.emit("magic value", "ShaderNodeTexMagic", output="Fac", inputs={"Vector": _place})
    check(grid, atol=3e-3)


def test_brick(grid):
    for output in ("Color", "Fac"):
        for smooth in (0.0, 0.6):
            for offset, squash in ((2, 2), (3, 1), (1, 3)):
                inputs = {"Vector": _place, "Scale": 3.0, "Mortar Size": 0.06, "Mortar Smooth": smooth, "Bias": 0.1}
                inputs |= {"Color1": (0.8, 0.2, 0.1, 1), "Color2": (0.2, 0.5, 0.7, 1), "Mortar": (0.1, 0.1, 0.05, 1)}
                settings = {"offset_frequency": offset, "squash_frequency": squash, "squash": 0.7, "offset": 0.4, "inputs": inputs}
                grid.emit(f"{output} {smooth} {offset} {squash}", "ShaderNodeTexBrick", output=output, **settings)
    check(grid, outliers=0.02)


def test_voronoi(grid):
    for dimensions in ("1D", "2D", "3D", "4D"):
        for feature in FEATURES:
            inputs = {"Vector": _place, "Scale": 2.7, "Randomness": 0.8}
            if dimensions in ("1D", "4D"):
                inputs["W"] = _weight
            if feature == "SMOOTH_F1":
                inputs["Smoothness"] = 0.6
            settings = {"voronoi_dimensions": dimensions, "feature": feature}
            outputs = ["Radius"] if feature == "N_SPHERE_RADIUS" else ["Distance"]
            if len(feature) < 10:
                outputs += ["Color"] + ["Position"] * (dimensions != "1D") + ["W"] * (dimensions in ("1D", "4D"))
            for output in outputs:
                grid.emit(f"{dimensions} {feature} {output}", "ShaderNodeTexVoronoi", output=output, inputs=inputs, **settings)
    check(grid, outliers=0.05)  # where two points are equally far
    assert not grid.warnings


def test_voronoi_in_octaves(grid):
    for feature in ("F1", "F2", "SMOOTH_F1", "DISTANCE_TO_EDGE"):
        for normalize in (False, True):
            inputs = {"Vector": _place, "Scale": 2.0, "Detail": 1.4, "Roughness": 0.6, "Lacunarity": 2.2}
            for output in ["Distance"] + ["Color", "Position"] * (feature != "DISTANCE_TO_EDGE"):
                settings = {"feature": feature, "normalize": normalize, "inputs": inputs}
                grid.emit(f"{feature} {normalize} {output}", "ShaderNodeTexVoronoi", output=output, **settings)
    for metric in METRICS:
        for feature in ("F1", "F2"):
            inputs = {"Vector": _place, "Scale": 3.0} | ({"Exponent": 1.7} if metric == "MINKOWSKI" else {})
            settings = {"feature": feature, "distance": metric, "normalize": True, "inputs": inputs}
            grid.emit(f"{metric} {feature}", "ShaderNodeTexVoronoi", **settings)
    check(grid, outliers=0.05)
