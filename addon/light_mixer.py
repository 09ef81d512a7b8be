"""A node group in the compositor that mixes light groups: each dimmed, brightened and coloured after the render."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from .compositor import adding, compositor_of, insert_after, named, rendered_node

GROUP_NAME = "Lumigate Light Groups"
NODE_NAME = "Lumigate Light Groups"
GAIN, COLOR = "Gain", "Color"
_MOST = 100.0  # gain
_ROW = 180  # between the nodes of two groups


def mixer(scene: bpy.types.Scene) -> bpy.types.Node | None:
    """The mixer in the scene's compositor, if there is one."""
    tree = scene.compositing_node_group if hasattr(scene, "compositing_node_group") else scene.node_tree
    return tree.nodes.get(NODE_NAME) if tree is not None else None


def controls(node: bpy.types.Node) -> Iterator[tuple[str, bpy.types.NodeSocket, bpy.types.NodeSocket]]:
    """Name, gain and colour of each light group of a mixer."""
    for socket in node.inputs:
        if f"{GAIN} {socket.name}" in node.inputs:
            yield socket.name, node.inputs[f"{GAIN} {socket.name}"], node.inputs[f"{COLOR} {socket.name}"]


def wire_mixer(scene: bpy.types.Scene, source: bpy.types.Node, layer: str, names: list[str]) -> bpy.types.Node:
    """A mixer of the passes `<layer>_<name>` of `source`, a node of the scene's compositor.

    One that is there keeps the gains and colours of the groups that it has still.
    """
    tree = compositor_of(scene)
    node = tree.nodes.get(NODE_NAME) or named(tree.nodes.new("CompositorNodeGroup"), NODE_NAME)
    if node.node_tree is None or [name for name, *_ in controls(node)] != names:
        kept = (
            {} if node.node_tree is None else {name: (gain.default_value, color.default_value[:]) for name, gain, color in controls(node)}
        )
        unused = node.node_tree
        node.node_tree = _group(names)
        for name, gain, color in controls(node):
            gain.default_value, color.default_value = kept.get(name, (1.0, (1.0, 1.0, 1.0, 1.0)))
        if unused is not None and unused.users == 0:
            bpy.data.node_groups.remove(unused)
    for name in names:
        tree.links.new(source.outputs[f"{layer}_{name}"], node.inputs[name])
    node.location = source.location.x + source.width + 60, source.location.y - 300
    return node


def mix_render(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, names: list[str]) -> bpy.types.Node:
    """Put a mixer of the light groups that a render of the view layer gives in the place of its picture; the mixer's node."""
    rendered = rendered_node(scene, view_layer)
    tree = rendered.id_data
    node = wire_mixer(scene, rendered, "Combined", names)
    insert_after(tree, rendered.outputs["Image"], node.outputs["Image"])
    return node


def _group(names: list[str]) -> bpy.types.NodeTree:
    """The group: the sum over the light groups of gain * colour * light."""
    group = bpy.data.node_groups.new(GROUP_NAME, "CompositorNodeTree")
    group.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    begin, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    total = None
    for row, name in enumerate(names):
        light = group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
        light.default_value, light.hide_value = (0.0, 0.0, 0.0, 1.0), True
        gain = group.interface.new_socket(f"{GAIN} {name}", in_out="INPUT", socket_type="NodeSocketFloat")
        gain.default_value, gain.min_value, gain.max_value = 1.0, 0.0, _MOST
        color = group.interface.new_socket(f"{COLOR} {name}", in_out="INPUT", socket_type="NodeSocketColor")
        color.default_value = (1.0, 1.0, 1.0, 1.0)
        tinted = adding(group, "MULTIPLY")
        tinted.factor.default_value = 1.0
        group.links.new(begin.outputs[name], tinted.first)
        group.links.new(begin.outputs[f"{COLOR} {name}"], tinted.second)
        added = adding(group, "ADD")
        group.links.new(begin.outputs[f"{GAIN} {name}"], added.factor)
        group.links.new(tinted.result, added.second)
        if total is None:
            added.first.default_value = (0.0, 0.0, 0.0, 1.0)
        else:
            group.links.new(total, added.first)
        total = added.result
        tinted.node.location, added.node.location = (200, -_ROW * row), (420, -_ROW * row)
    group.links.new(total, end.inputs["Image"])
    end.location.x = 640
    return group
