"""Figures as JSON files."""

from __future__ import annotations

import json
from pathlib import Path

from ..core.layers import write_whole


def write_json(path: Path, content: dict) -> None:
    """Write `content` to `path`, whole or not at all; SceneError where it cannot be written."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    write_whole(path, lambda partial: partial.write_text(text, encoding="utf-8"))
