"""Lightmaps by Cycles' own bake: reference and peer of `lumigate bake`, on the same objects, UV map and size."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

import bpy
import numpy as np

from ..addon.extract.evaluation import overridden
from .console import quiet
from .interrupts import ending_amid

PASSES = {"irradiance": {"DIRECT", "INDIRECT"}, "indirect": {"INDIRECT"}}
_MANY_BOUNCES = 256  # as in `reference`: only diffuse ones cut


def bake_by_cycles(
    scene: bpy.types.Scene,
    objects: Sequence[bpy.types.Object],
    layer: str,
    size: tuple[int, int],
    *,
    content: str = "irradiance",
    samples: int = 64,
    bounces: int = 4,
    seed: int = 0,
    margin: int = 4,
) -> tuple[np.ndarray, float]:
    """One image (H, W, 3) float32 of the irradiance (W/m^2) of all objects, first row at the top, and the seconds of the bake.

    layer: the UV map, which all objects have.  content: a key of `PASSES`.  The scene is as before afterwards.
    """
    settings = {
        "device": "CPU",
        "samples": samples,
        "seed": seed,
        "use_adaptive_sampling": False,
        "use_denoising": False,
        "sample_clamp_direct": 0.0,
        "sample_clamp_indirect": 0.0,
        "blur_glossy": 0.0,
        "light_sampling_threshold": 0.0,
        "diffuse_bounces": bounces,
        "glossy_bounces": _MANY_BOUNCES,
        "transmission_bounces": _MANY_BOUNCES,
        "max_bounces": 4 * _MANY_BOUNCES,
        "transparent_max_bounces": 4 * _MANY_BOUNCES,
    }
    image = bpy.data.images.new("Lumigate Cycles bake", *size, alpha=False, float_buffer=True)
    view_layer = scene.view_layers[0]
    try:
        with ExitStack() as stack:
            stack.enter_context(overridden(scene.render, engine="CYCLES"))
            stack.enter_context(overridden(scene.cycles, **settings))
            stack.enter_context(_aimed(objects, image))
            stack.enter_context(_selected(view_layer, objects))
            active = view_layer.objects.active
            context = {"scene": scene, "view_layer": view_layer, "object": active, "active_object": active}
            stack.enter_context(bpy.context.temp_override(**context, selected_objects=list(objects)))
            stack.enter_context(quiet())
            stack.enter_context(ending_amid())
            begin = time.perf_counter()
            bpy.ops.object.bake(
                type="DIFFUSE", pass_filter=PASSES[content], margin=margin, margin_type="EXTEND", uv_layer=layer, use_clear=True,
                target="IMAGE_TEXTURES",
            )  # fmt: skip
            seconds = time.perf_counter() - begin
        pixels = np.empty(size[0] * size[1] * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    # Cycles bakes the radiance of a white diffuse surface, last row first.
    return np.pi * pixels.reshape(size[1], size[0], -1)[::-1, :, :3], seconds


@contextmanager
def _aimed(objects: Sequence[bpy.types.Object], image: bpy.types.Image) -> Iterator[None]:
    """Every material of the objects has `image` as the target of a bake."""
    materials = dict.fromkeys(slot.material for ob in objects for slot in ob.material_slots if slot.material is not None)
    before = []
    try:
        for material in materials:
            tree = material.node_tree
            node = tree.nodes.new("ShaderNodeTexImage")
            before.append((tree, tree.nodes.active, node))
            node.image = image
            tree.nodes.active = node
        yield
    finally:
        for tree, active, node in before:
            tree.nodes.remove(node)
            if active is not None:
                tree.nodes.active = active


@contextmanager
def _selected(view_layer: bpy.types.ViewLayer, objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """The objects, and only they, are selected, the first one active."""
    before = [ob for ob in view_layer.objects if ob.select_get(view_layer=view_layer)]
    active = view_layer.objects.active
    try:
        for ob in before:
            ob.select_set(False, view_layer=view_layer)
        for ob in objects:
            ob.select_set(True, view_layer=view_layer)
        view_layer.objects.active = objects[0]
        yield
    finally:
        for ob in objects:
            ob.select_set(False, view_layer=view_layer)
        for ob in before:
            ob.select_set(True, view_layer=view_layer)
        view_layer.objects.active = active
