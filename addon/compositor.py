"""A node group in the compositor that adds the indirect light to a picture of any renderer."""

from __future__ import annotations

from typing import NamedTuple

import bpy

GROUP_NAME = "Lumigate Indirect Light"
NODE_NAME = "Lumigate"
_IMAGE_NODE_NAME = "Lumigate Layers"
_GAP = 60  # between nodes


def wire(scene: bpy.types.Scene, image: bpy.types.Image, view_layer: str) -> bpy.types.Node:
    """Put picture + strength * Indirect of `image` before the end of the scene's compositor; the group's node.

    Where the group is there already, it gets the new image.
    """
    tree = compositor_of(scene)
    source = tree.nodes.get(_IMAGE_NODE_NAME) or named(tree.nodes.new("CompositorNodeImage"), _IMAGE_NODE_NAME)
    source.image = image
    if source.has_layers:
        source.layer = view_layer
    adder = tree.nodes.get(NODE_NAME)
    if adder is None:
        adder = named(tree.nodes.new("CompositorNodeGroup"), NODE_NAME)
        adder.node_tree = bpy.data.node_groups.get(GROUP_NAME) or _group()
        _insert(scene, view_layer, adder, source)
    tree.links.new(source.outputs["Indirect"], adder.inputs["Indirect"])
    return adder


def layers_node(scene: bpy.types.Scene) -> bpy.types.Node:
    """The node of the image that `wire` has put in."""
    return compositor_of(scene).nodes[_IMAGE_NODE_NAME]


def rendered_node(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> bpy.types.Node:
    """The node of the compositor that gives what is rendered of a view layer, with the sockets that it has now; made where there is none."""
    tree = compositor_of(scene)
    found = [node for node in tree.nodes if node.type == "R_LAYERS" and node.scene == scene and node.layer == view_layer.name]
    node = found[0] if found else tree.nodes.new("CompositorNodeRLayers")
    if not found:
        node.scene, node.layer = scene, view_layer.name
    view_layer.update_render_passes()
    return node


def insert_after(tree: bpy.types.NodeTree, before: bpy.types.NodeSocket, after: bpy.types.NodeSocket) -> None:
    """What read the output `before` reads `after` instead; where nothing did, the end of the tree does."""
    readers = [link.to_socket for link in before.links if link.to_node != after.node]
    if not readers and not after.is_linked:
        readers = [_end(tree)]
    for reader in readers:
        tree.links.new(after, reader)


def named(node: bpy.types.Node, name: str) -> bpy.types.Node:
    node.name = node.label = name
    return node


def compositor_of(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """The scene's compositor, made if there is none, and in use."""
    if not hasattr(scene, "compositing_node_group"):  # before Blender 5
        scene.use_nodes = True
        return scene.node_tree
    if scene.compositing_node_group is None:
        tree = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        rendered, end = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("NodeGroupOutput")
        end.location.x = rendered.location.x + 400
        tree.links.new(rendered.outputs["Image"], end.inputs["Image"])
        scene.compositing_node_group = tree
    scene.render.use_compositing = True
    return scene.compositing_node_group


def _end(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """The input socket that takes the picture."""
    kinds = ("COMPOSITE", "GROUP_OUTPUT")
    end = next((node for node in tree.nodes if node.type in kinds and not node.mute), None)
    if end is None:
        kind = "CompositorNodeComposite" if hasattr(bpy.types, "CompositorNodeComposite") else "NodeGroupOutput"
        end = tree.nodes.new(kind)
    if not [socket for socket in end.inputs if socket.type == "RGBA"]:  # a group without a picture
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    return next(socket for socket in end.inputs if socket.type == "RGBA")


def _insert(scene: bpy.types.Scene, view_layer: str, adder: bpy.types.Node, source: bpy.types.Node) -> None:
    """Between the end of the tree and what feeds it."""
    tree = adder.id_data
    end = _end(tree)
    if end.is_linked:
        before = end.links[0].from_socket
    else:
        before = rendered_node(scene, scene.view_layers.get(view_layer) or scene.view_layers[0]).outputs["Image"]
    tree.links.new(before, adder.inputs["Image"])
    tree.links.new(adder.outputs["Image"], end)
    end.node.location.x += adder.width + _GAP
    adder.location = end.node.location.x - adder.width - _GAP, end.node.location.y
    source.location = before.node.location.x, adder.location.y - 500


def _group() -> bpy.types.NodeTree:
    """The group: Image + Strength * Indirect, and Image's alpha."""
    group = bpy.data.node_groups.new(GROUP_NAME, "CompositorNodeTree")
    group.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    for name in ("Image", "Indirect"):
        group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
    strength = group.interface.new_socket("Strength", in_out="INPUT", socket_type="NodeSocketFloat")
    strength.default_value, strength.min_value, strength.max_value = 1.0, 0.0, 10.0
    begin, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    factor, first, second, result = adding(group)
    group.links.new(begin.outputs["Image"], first)
    group.links.new(begin.outputs["Indirect"], second)
    group.links.new(begin.outputs["Strength"], factor)
    group.links.new(result, end.inputs["Image"])
    begin.location.x, end.location.x = -250, 250
    return group


class Mix(NamedTuple):
    """Sockets of a node that mixes two colours."""

    factor: bpy.types.NodeSocket
    first: bpy.types.NodeSocket
    second: bpy.types.NodeSocket
    result: bpy.types.NodeSocket

    @property
    def node(self) -> bpy.types.Node:
        """Whose sockets they are."""
        return self.result.node


def adding(group: bpy.types.NodeTree, blend: str = "ADD") -> Mix:
    """A node that gives first + factor * second; with `blend` MULTIPLY and factor 1, first * second."""
    if hasattr(bpy.types, "CompositorNodeMixRGB"):  # before Blender 5
        mix = group.nodes.new("CompositorNodeMixRGB")
        mix.blend_type = blend
        return Mix(mix.inputs[0], mix.inputs[1], mix.inputs[2], mix.outputs[0])
    mix = group.nodes.new("ShaderNodeMix")
    mix.data_type, mix.blend_type, mix.clamp_factor = "RGBA", blend, False
    sockets = {socket.identifier: socket for socket in (*mix.inputs, *mix.outputs)}
    return Mix(*(sockets[name] for name in ("Factor_Float", "A_Color", "B_Color", "Result_Color")))
