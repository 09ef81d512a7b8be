"""Principled materials, whose textures are painted with NumPy and packed into the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Surface:
    """A Blender material and the size of one repeat of its texture, in metres."""

    material: Any
    tile: float = 1.0


def image(name: str, pixels: np.ndarray, linear: bool = False):
    """A packed Blender image.  pixels: (H, W, 3 or 4) linear RGB, row 0 at the bottom (v = 0).

    `linear` keeps float32 radiance; otherwise the colours are stored in 8 bits as sRGB.
    """
    import bpy

    height, width, channels = pixels.shape
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :channels] = pixels
    if not linear:
        colour = np.clip(rgba[..., :3], 0, 1)
        rgba[..., :3] = np.where(colour <= 0.0031308, 12.92 * colour, 1.055 * colour ** (1 / 2.4) - 0.055)
    picture = bpy.data.images.new(name, width, height, alpha=channels == 4, float_buffer=linear)
    picture.pixels.foreach_set(rgba.ravel())
    picture.pack()
    return picture


def _new(name: str):
    """A material with an empty node tree, and its output node."""
    import bpy

    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    material.node_tree.nodes.clear()
    return material, material.node_tree, material.node_tree.nodes.new("ShaderNodeOutputMaterial")


def principled(
    name: str,
    colour: Sequence[float] | np.ndarray,
    *,
    tile: float = 1.0,
    roughness: float = 0.6,
    specular: float = 0.25,
    metallic: float = 0.0,
    emission: Sequence[float] | None = None,
    strength: float = 0.0,
) -> Surface:
    """A Principled material.  colour: linear RGB, or texture pixels (H, W, 3) or (H, W, 4), whose fourth channel is opacity.

    emission and strength: linear RGB times W/m^2/sr.
    """
    material, tree, output = _new(name)
    shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    values = {"Roughness": roughness, "Specular IOR Level": specular, "Metallic": metallic, "Emission Strength": strength}
    for key, value in values.items():
        shader.inputs[key].default_value = value
    shader.inputs["Emission Color"].default_value = (*(emission if emission is not None else (0, 0, 0)), 1)
    colour = np.asarray(colour, float)
    if colour.ndim == 1:
        shader.inputs["Base Color"].default_value = (*colour, 1)
    else:
        texture = tree.nodes.new("ShaderNodeTexImage")
        texture.image = image(name, colour)
        tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        if colour.shape[2] == 4:
            tree.links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    return Surface(material, tile)


def emitter(name: str, colour: Sequence[float], strength: float) -> Surface:
    """A material that only shines, with the radiance colour x strength (W/m^2/sr)."""
    material, tree, output = _new(name)
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.inputs["Color"].default_value = (*colour, 1)
    shader.inputs["Strength"].default_value = strength
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return Surface(material)


def coloured_glass(name: str, transmittance: np.ndarray, tile: float = 1.0) -> Surface:
    """A thin pane (no thickness, no refraction) that tints the light that goes straight through; pixels (H, W, 3) as `principled`."""
    material, tree, output = _new(name)
    mix = tree.nodes.new("ShaderNodeMixShader")
    through = tree.nodes.new("ShaderNodeBsdfTransparent")
    shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image(name, transmittance)
    mix.inputs[0].default_value = 0.06
    shader.inputs["Roughness"].default_value = 0.15
    for target in (through.inputs["Color"], shader.inputs["Base Color"]):
        tree.links.new(texture.outputs["Color"], target)
    tree.links.new(through.outputs[0], mix.inputs[1])
    tree.links.new(shader.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return Surface(material, tile)
