"""Walks a node tree: links, reroutes, muted nodes, node groups and the conversions between socket types."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import bpy

from ...core.surfaces import outlined, textures
from ...core.surfaces import program as ops
from ...core.surfaces.arithmetic import SCALAR, VECTOR
from . import registry
from .bake import Baker
from .builder import ONE, ZERO, Constant, Program, Value, scalar
from .requests import BAKED, Shot

# What a bake cannot know, by node and output ('' is all of them).
_BLIND = {
    ("ShaderNodeTexCoord", "Reflection"): "as seen from right above the surface",
    ("ShaderNodeNewGeometry", "Incoming"): "as seen from right above the surface",
    ("ShaderNodeAmbientOcclusion", ""): "without the objects of other materials around",
    ("ShaderNodeParticleInfo", ""): "without particles, all of which look alike",
}
# Blender 5 hands Cycles trees without groups, reroutes and muted nodes: these convert nothing, and what a group's socket says is a number for all.
_INLINED = bpy.app.version >= (5, 0)
_EEVEES = frozenset({"ShaderNodeEeveeSpecular", "ShaderNodeShaderToRGB"})
_WHOLE = ("INT", "BOOLEAN")
_SCALARS = ("VALUE", *_WHOLE)


@dataclass
class Fading:
    """What Light Falloff nodes do to a lamp.

    strength: by which they multiply theirs, to be told apart.  found: (exponent, smoothing) of each, as `core.scene.Lamps.falloff`.
    """

    strength: float = 1.0
    found: set[tuple[float, float]] = field(default_factory=set)


@dataclass
class Context:
    """What the node functions of one material share.

    fading: of a lamp, where its Light Falloff nodes put down what they are; None where there is no distance to fade by.
    is_lamp: whether it is the tree of a lamp, run for each ray that leaves it.
    shot: what it may ask of the render.
    normal: the shading normal where the material's displacement bends it, None for the surface's own.
    """

    material: bpy.types.Material
    program: Program
    textures: textures.TexturePool
    warnings: list[str]
    baker: Baker
    objects: tuple[bpy.types.Object, ...] = ()
    memory: dict = field(default_factory=dict)
    fading: Fading | None = None
    is_lamp: bool = False
    shot: Shot = field(default_factory=Shot)
    normal: Value | None = None

    def warn(self, text: str) -> None:
        """One line for the user, once for each material."""
        line = f"{'Lamp' if self.is_lamp else 'Material'} '{self.material.name}': {text}"
        if line not in self.warnings:
            self.warnings.append(line)


class Origin(NamedTuple):
    """What feeds an input: a node's output socket; else the first socket on the way to it that nothing feeds, which is all there is to read.

    passed: types of the sockets between the two, of reroutes, muted nodes and groups, which convert what passes them.
    """

    scope: Scope
    socket: bpy.types.NodeSocket
    passed: tuple[str, ...] = ()

    @property
    def is_computed(self) -> bool:
        """Whether a node computes it; what stays is a number."""
        return self.socket.is_output and (self.socket.node.type != "GROUP" and not self.socket.node.mute)

    @property
    def is_link(self) -> bool:
        """Whether it is a link to Cycles, which up to Blender 4.5 hands what nothing feeds on to the input itself, unless it is converted on the way."""
        return _INLINED or self.is_computed or any(a != b for a, b in pairwise((self.socket.type, *self.passed)))

    def default(self) -> Value:
        """The number where no node computes it: groups have their own, all else is zero."""
        node = self.socket.node
        return ZERO if self.socket.is_output or node.mute or node.type == "REROUTE" else default(self.socket)


@dataclass(frozen=True)
class Scope:
    """A node tree, and where it is used: the group node and its scope, None for the material's own tree."""

    context: Context
    tree: bpy.types.NodeTree
    parent: Scope | None = None
    group: bpy.types.Node | None = None

    @property
    def path(self) -> tuple:
        """Names of the group nodes from the material's tree to this one."""
        return () if self.parent is None else (*self.parent.path, self.group.name)

    def source(self, socket: bpy.types.NodeSocket) -> Origin | None:
        """What feeds an input, past reroutes, muted nodes and group borders (`add_nodes` of Cycles' blender/shader.cpp); None if unlinked."""
        link = next((k for k in socket.links if k.is_valid and not k.is_muted), None)
        if link is None:
            return None
        node, output = link.from_node, link.from_socket
        if node.bl_idname in _EEVEES:
            self.context.warn(f"node '{node.name}': EEVEE alone knows it: nothing comes from it, as in Cycles")
            return None
        if node.type == "REROUTE":
            return self._passing(node.inputs[0], output)
        if node.mute:
            inlet = next((k.from_socket for k in node.internal_links if k.to_socket == output), None)
            return inlet and self._passing(inlet, output)
        if node.type == "GROUP_INPUT":
            outer = self.parent and next((s for s in self.group.inputs if s.identifier == output.identifier), None)
            return self.parent._passing(outer, outer) if outer else None
        if node.type == "GROUP" and node.node_tree is not None:
            inside = Scope(self.context, node.node_tree, self, node)
            end = next((n for n in node.node_tree.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output), None)
            inner = end and next((s for s in end.inputs if s.identifier == output.identifier), None)
            return inside._passing(inner, output) if inner else Origin(self, output)
        return Origin(self, output)

    def _passing(self, inlet: bpy.types.NodeSocket, outlet: bpy.types.NodeSocket) -> Origin | None:
        """What feeds an input that a socket hands on."""
        found = self.source(inlet)
        if found is None:
            return None if _INLINED and (inlet.node.mute or inlet.node.type == "REROUTE") else Origin(self, inlet)
        return found if _INLINED else found._replace(passed=(*found.passed, outlet.type))

    def read(self, socket: bpy.types.NodeSocket) -> Value:
        """Value of an input socket, converted to the socket's type."""
        found = self.source(socket)
        if found is None:
            return default(socket)
        result = found.scope.output(found.socket) if found.is_computed else found.default()
        for source, target in pairwise((found.socket.type, *found.passed, socket.type)):
            result = self._converted(result, source, target)
        return result

    def output(self, socket: bpy.types.NodeSocket) -> Value:
        """Value of an output socket; each is computed once."""
        node = socket.node
        key = (self.path, node.name, socket.identifier, self.context.program.step)
        memory = self.context.memory
        if key not in memory:
            function = registry.VALUES.get(node.bl_idname)
            try:
                if function is None:
                    raise registry.Unsupported(f"node '{node.name}' ({node.bl_label}) is not known")
                memory[key] = function(NodeInput(self, node), socket.identifier)
            except registry.Unsupported as reason:
                memory[key] = self._baked(socket, reason)
        return memory[key]

    def _baked(self, socket: bpy.types.NodeSocket, reason: registry.Unsupported) -> Value:
        """The socket's colour from a texture that Cycles bakes."""
        context = self.context
        try:
            pixels = context.baker.bake(self, socket)
        except registry.Unsupported as obstacle:
            raise registry.Unsupported(f"{reason}, and it cannot be baked: {obstacle}") from None
        kind = socket.node.bl_idname
        blind = _BLIND.get((kind, socket.name)) or _BLIND.get((kind, ""))
        context.warn(f"{reason}; its output '{socket.name}' was baked by Cycles" + (f", {blind}" if blind else ""))
        key = "baked", context.material.name_full, self.path, socket.node.name, socket.identifier
        texture = context.textures.add(key, lambda: pixels, textures.EXTEND, textures.LINEAR, 0)
        at = context.program.attribute(BAKED, context.material.name_full)
        return context.program.emit(ops.TEXTURE, at, p=texture)

    def _converted(self, value: Value, source: str, target: str) -> Value:
        emit = self.context.program.emit
        if target in _SCALARS and source == "RGBA":
            value = emit(ops.LUMINANCE, value)
        elif target in _SCALARS and source == "VECTOR":
            value = emit(ops.AVERAGE, value)
        if target in _WHOLE and source not in _WHOLE:
            value = emit(outlined.MATH, value, p=SCALAR["TRUNC"])
        return value

    def shade(self, socket: bpy.types.NodeSocket, weight: Value) -> None:
        """Adds the closures that feed a shader socket."""
        found = self.source(socket)
        if found is None or weight == ZERO or not found.is_computed:
            return
        scope, origin, _ = found
        if origin.type != "SHADER":
            # Blender converts a colour in a shader socket to emission.
            color = scope.output(origin)
            self.context.program.emit(ops.EMISSION_CLOSURE, color, ZERO, ZERO, weight)
            return
        node = origin.node
        function = registry.CLOSURES.get(node.bl_idname)
        if function is None:
            raise registry.Unsupported(f"shader '{node.name}' ({node.bl_label}) is not known")
        function(NodeInput(scope, node), weight)


@dataclass(frozen=True)
class NodeInput:
    """A node as the functions of `registry` see it: its inputs as values, and short forms of instructions."""

    scope: Scope
    node: bpy.types.Node

    @property
    def context(self) -> Context:
        return self.scope.context

    @property
    def program(self) -> Program:
        return self.scope.context.program

    def socket(self, key: str | int) -> bpy.types.NodeSocket:
        """Input by identifier, else by name, or by index."""
        inputs = self.node.inputs
        if isinstance(key, int):
            return inputs[key]
        return next((s for s in inputs if s.identifier == key), None) or inputs[key]

    def has(self, key: str) -> bool:
        """Whether this version of Blender has the input."""
        return any(s.identifier == key or s.name == key for s in self.node.inputs)

    def linked(self, key: str | int) -> bool:
        """Whether something feeds the input, as Cycles sees it, which else takes what it does for the node (its normal, its coordinates)."""
        found = self.scope.source(self.socket(key))
        return found is not None and found.is_link

    def __getitem__(self, key: str | int) -> Value:
        return self.scope.read(self.socket(key))

    def warn(self, text: str) -> None:
        """A warning that names the node too."""
        self.context.warn(f"node '{self.node.name}': {text}")

    def emit(self, op: int, *operands, p: int = 0) -> Value:
        return self.program.emit(op, *operands, p=p)

    def math(self, kind: str, *operands: Value) -> Value:
        """Math node `kind` on scalars."""
        return self.emit(outlined.MATH, *operands, p=SCALAR[kind])

    def math_rgb(self, kind: str, *operands: Value) -> Value:
        """Math node `kind` on each component."""
        parts = [self.math(kind, *(self.splat(o, c) for o in operands)) for c in range(3)]
        return self.pack(*parts, ONE)

    def vector(self, kind: str, *operands: Value) -> Value:
        """Vector Math node `kind`."""
        return self.emit(outlined.VECTOR_MATH, *operands, p=VECTOR[kind])

    def multiply(self, a: Value, b: Value) -> Value:
        """a b per component; nothing is computed where one is 0 or 1."""
        for x, y in ((a, b), (b, a)):
            if isinstance(x, Constant) and x.rgb == ONE.rgb:
                return y
            if isinstance(x, Constant) and x.rgb == ZERO.rgb:
                return ZERO
        return self.emit(ops.SCALE, a, b)

    def complement(self, a: Value) -> Value:
        """1 - a per component."""
        return self.vector("SUBTRACT", ONE, a)

    def clamp(self, a: Value, low: Value = ZERO, high: Value = ONE) -> Value:
        """a between low and high per component."""
        return self.emit(ops.CLAMP, a, low, high)

    def splat(self, a: Value, component: int) -> Value:
        """One component of a as a scalar."""
        return self.emit(ops.SPLAT, a, p=component)

    def pack(self, *scalars: Value) -> Value:
        """Up to four scalars in one row."""
        return self.emit(ops.PACK, *scalars, *[ZERO] * (4 - len(scalars)))


def default(socket: bpy.types.NodeSocket) -> Constant:
    """The value an unlinked socket shows."""
    value = getattr(socket, "default_value", 0.0)
    if isinstance(value, (int, float, bool)):
        return scalar(value)
    if isinstance(value, str) or not hasattr(value, "__len__"):
        return ZERO
    components = [float(c) for c in value][:4]
    return Constant(*components, *[0.0] * (3 - len(components)))
