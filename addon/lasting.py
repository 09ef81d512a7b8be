"""Data-blocks that work of a while refers to: found again though they were renamed meanwhile, or undo has read them anew."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import bpy

Block = TypeVar("Block", bound=bpy.types.ID)


def by_uid(blocks: Iterable[Block]) -> dict[int, Block]:
    """Data-blocks by the number that each keeps for as long as its file is open."""
    return {block.session_uid: block for block in blocks}
