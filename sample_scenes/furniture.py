"""Movable things of a house: tables, chairs, shelves, beds, pictures and lamps, each standing on z = 0."""

from __future__ import annotations

import numpy as np

from .primitives import Shape, arc, box, joined, lathe, sweep
from .stage import Detail


def table(detail: Detail, width: float, depth: float, height: float, top: float = 0.04) -> Shape:
    """A table with four legs and an apron."""
    edge = detail.chamfer(0.006)
    parts = [box((width, depth, top), (0, 0, height - top / 2), edge)]
    for x in (-1, 1):
        for y in (-1, 1):
            parts.append(
                box((0.06, 0.06, height - top + 0.002), (x * (width / 2 - 0.07), y * (depth / 2 - 0.07), (height - top) / 2 + 0.001), edge)
            )
    for y in (-1, 1):
        parts.append(box((width - 0.17, 0.025, 0.09), (0, y * (depth / 2 - 0.07), height - top - 0.04), 0))
    for x in (-1, 1):
        parts.append(box((0.025, depth - 0.17, 0.09), (x * (width / 2 - 0.07), 0, height - top - 0.04), 0))
    return joined(parts)


def chair(detail: Detail) -> Shape:
    """A plain chair, its back towards +y; the seat is material slot 1."""
    edge = detail.chamfer(0.005)
    parts = [box((0.44, 0.44, 0.05), (0, 0, 0.455), edge).slotted(1)]
    for x in (-1, 1):
        parts.append(box((0.038, 0.038, 0.44), (x * 0.19, -0.19, 0.22), edge))
        parts.append(box((0.038, 0.038, 0.92), (x * 0.19, 0.205, 0.46), edge))
    for z in (0.6, 0.72, 0.86):
        parts.append(box((0.36, 0.018, 0.07), (0, 0.205, z), edge))
    return joined(parts)


def bookcase(detail: Detail, seed: int, width: float, height: float, shelves: int, colours: int) -> Shape:
    """An open bookcase (slot 0) with its back towards +y, full of books in slots 1 to `colours`."""
    rng = np.random.default_rng(seed)
    depth, board = 0.32, 0.025
    edge = detail.chamfer(0.003)
    parts = [box((board, depth, height), (x * (width - board) / 2, 0, height / 2), edge) for x in (-1, 1)]
    parts.append(box((width - board, 0.012, height - 0.004), (0, depth / 2 - 0.01, height / 2), 0))
    pitch = (height - board) / shelves
    for shelf in range(shelves + 1):
        level = shelf * pitch + board / 2 + (0.001 if shelf == 0 else -0.001 if shelf == shelves else 0)
        parts.append(box((width - board, depth - 0.02, board), (0, -0.004, level), edge))
        if shelf == shelves:
            break
        x, end = -width / 2 + 0.04, width / 2 - 0.04
        while x < end - 0.06:
            if rng.uniform() < 0.07:
                x += rng.uniform(0.05, 0.2)
                continue
            thick = rng.uniform(0.02, 0.05) * (1 if detail.full else 4)
            tall, deep = rng.uniform(0.6, 0.86) * pitch, rng.uniform(0.16, 0.23)
            book = box(
                (thick - 0.002, deep, tall),
                (x + thick / 2, depth / 2 - 0.03 - deep / 2, level + board / 2 + tall / 2 + 0.001),
                detail.chamfer(0.002),
            )
            parts.append(book.slotted(1 + rng.integers(colours)))
            x += thick
    return joined(parts)


def bed(detail: Detail) -> Shape:
    """A single bed, its head towards +y: frame (slot 0), blanket (1), pillow (2)."""
    edge = detail.chamfer(0.01)
    soft = 0.05 if detail.full else 0.0
    return joined(
        [
            box((0.98, 2.05, 0.2), (0, 0, 0.24), edge),
            box((0.98, 0.06, 0.95), (0, 1.04, 0.475), edge),
            *[box((0.07, 0.07, 0.3), (x * 0.42, y * 0.9, 0.15), edge) for x in (-1, 1) for y in (-1, 1)],
            box((1.04, 1.5, 0.24), (0, -0.28, 0.44), soft).slotted(1),
            box((0.92, 1.96, 0.16), (0, 0.0, 0.4), soft).slotted(2),
            box((0.66, 0.4, 0.16), (0, 0.72, 0.54), 0.06 if detail.full else 0.0).slotted(2),
        ]
    )


def picture(detail: Detail, width: float, height: float, moulding: float = 0.06) -> Shape:
    """A framed picture that hangs in the xz plane with its middle at the origin and faces -y: frame (slot 0), canvas (1).

    The canvas's texture covers it once.
    """
    edge = detail.chamfer(0.012)
    bars = [box((moulding, 0.045, height + 2 * moulding), (x * (width + moulding) / 2, 0, 0), edge) for x in (-1, 1)]
    bars += [box((width + 0.02, 0.043, moulding - 0.004), (0, 0.0, z * (height + moulding) / 2), edge) for z in (-1, 1)]
    canvas = box((width + 0.02, 0.016, height + 0.02), (0, 0.006, 0))
    uv = canvas.uv / [width, height]
    return joined([*bars, Shape(canvas.vertices, canvas.corners, canvas.sizes, uv - uv.min(axis=0), canvas.slots + 1)])


def lampshade(detail: Detail, low: float, high: float, height: float) -> Shape:
    """A conical shade with 3 mm walls, open below and above, between z = 0 and `height`; low and high are its radii."""
    segments = detail.segments(40, 10)
    outline = np.array([(low, 0.0), (high, height), (high - 0.003, height), (low - 0.003, 0.0)])
    path = np.column_stack([arc(1.0, 0, 2 * np.pi, segments)[:-1], np.zeros(segments)])
    return sweep(outline - [1.0, 0.0], path, closed=True)


def floor_lamp(detail: Detail, height: float) -> Shape:
    """The foot and stem of a standard lamp."""
    profile = np.array([(0.15, 0.0), (0.15, 0.015), (0.13, 0.025), (0.03, 0.03), (0.012, 0.05), (0.012, height)])
    return lathe(profile, detail.segments(28, 8))


def vase(detail: Detail, height: float, radius: float) -> Shape:
    """A closed, bellied vase."""
    outline = np.array(
        [
            (0.5, 0),
            (0.55, 0.02),
            (0.85, 0.2),
            (1.0, 0.42),
            (0.92, 0.62),
            (0.6, 0.8),
            (0.42, 0.88),
            (0.44, 0.95),
            (0.56, 1.0),
            (0.5, 1.0),
            (0.36, 0.9),
            (0.1, 0.88),
        ]
    )
    return lathe(outline * [radius, height], detail.segments(36, 10))
