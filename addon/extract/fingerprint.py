"""A hash of all that a node tree's result depends on, so that it can be kept from one run to the next."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np


def fingerprint(tree: bpy.types.NodeTree, *also: Any) -> str:
    """Hexadecimal hash of a node tree, its groups, images and curves, and of the plain values in `also`."""
    state = hashlib.sha256(repr((bpy.app.version, also)).encode())
    for line in _tree(tree):
        state.update(line.encode())
    return state.hexdigest()[:32]


def _tree(tree: bpy.types.NodeTree) -> Iterator[str]:
    for node in tree.nodes:
        yield f"node {node.name} {node.bl_idname} {node.mute}\n"
        yield from _struct(node, skip=frozenset(bpy.types.ShaderNode.bl_rna.properties.keys()))
        for socket in (*node.inputs, *node.outputs):
            value = getattr(socket, "default_value", None)
            yield f"socket {socket.identifier} {_plain(value)}\n"
    for link in tree.links:
        ends = link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier
        yield f"link {ends} {link.is_muted}\n"


def _struct(struct: bpy.types.bpy_struct, skip: frozenset[str] = frozenset()) -> Iterator[str]:
    """Lines for the properties of a struct and of what it owns."""
    for prop in struct.bl_rna.properties:
        name = prop.identifier
        if name == "rna_type" or name in skip:
            continue
        value = getattr(struct, name)
        if prop.type == "COLLECTION":
            for item in value:
                yield from _struct(item)
        elif prop.type != "POINTER":
            yield f"{name} {_plain(value)}\n"
        elif isinstance(value, bpy.types.NodeTree):
            yield from _tree(value)
        elif isinstance(value, bpy.types.Image):
            yield from _image(value)
        elif isinstance(value, bpy.types.ID):
            yield f"{name} {value.name_full}\n"
        elif value is not None:
            yield f"{name}\n"
            yield from _struct(value)


def _image(image: bpy.types.Image) -> Iterator[str]:
    """Lines for an image's pixels: cheap where they stand in a file that can be looked at."""
    yield f"image {image.source} {image.colorspace_settings.name} {image.alpha_mode} {tuple(image.size)}\n"
    if image.packed_file is not None:
        yield hashlib.sha256(image.packed_file.data).hexdigest()
        return
    path = Path(bpy.path.abspath(image.filepath, library=image.library))
    if image.source == "GENERATED" or image.is_dirty or not path.is_file():
        pixels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(pixels)
        yield hashlib.sha256(pixels).hexdigest()
    else:
        status = path.stat()
        yield f"{path} {status.st_size} {status.st_mtime_ns}\n"


def _plain(value: Any) -> str:
    """A number, string or array as text."""
    if isinstance(value, (bool, int, float, str, set)) or value is None:
        return repr(sorted(value)) if isinstance(value, set) else repr(value)
    if isinstance(value, bpy.types.ID):
        return value.name_full
    try:
        return repr([float(v) for v in np.asarray(value).ravel()])
    except (TypeError, ValueError):
        return ""
