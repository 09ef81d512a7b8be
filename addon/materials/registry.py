"""The node types the compiler knows: one small function each, in one of two tables.

A value function computes one output socket of a node; a closure function adds a shader node's closures
to the program.  The modules in `nodes` fill the tables by decorating their functions.
"""

from __future__ import annotations

from collections.abc import Callable

from .builder import Value

VALUES: dict[str, Callable] = {}
CLOSURES: dict[str, Callable] = {}


class Unsupported(Exception):
    """A node that cannot be turned into instructions; the message says why."""


def value(*types: str):
    """Registers `f(node: NodeInput, output: str) -> Value` for nodes of these `bl_idname`s."""

    def register(function: Callable[..., Value]):
        for name in types:
            VALUES[name] = function
        return function

    return register


def closure(*types: str):
    """Registers `f(node: NodeInput, weight: Value) -> None` for shader nodes of these `bl_idname`s."""

    def register(function: Callable[..., None]):
        for name in types:
            CLOSURES[name] = function
        return function

    return register
