"""The commands that README and docs print are ones that the command line takes."""

import re
import shlex
from pathlib import Path

import pytest

import lumigate
from lumigate.headless import arguments

ROOT = Path(lumigate.__file__).parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMAND = re.compile(
    r"(?:^ *|`)(?:uv run )?lumigate ((?:demo|render|farm|reference|bake|compare|inspect|bench) [^`\n]*?)(?= +# |[`\n])", re.MULTILINE
)
# What stands for a value.
VALUES = {
    "SCENE": "cornell",
    "SUITE": "kernels",
    "WxH": "64x36",
    "N": "8",
    "R": "64",
    "E": "0.1",
    "SCENE@WxH": "cornell",
    "FILE": "x.json",
    "PNG": "x.png",
}


def printed() -> list[tuple[str, str]]:
    """(page, command) of every command with its arguments; those that only begin one ("lumigate bench curves" in a sentence) need no output."""
    found = [(page.name, match[1]) for page in PAGES for match in COMMAND.finditer(page.read_text(encoding="utf-8"))]
    return [(page, command) for page, command in found if re.search(r" -o |^(compare|inspect) [A-Z]", command)]


def test_commands_are_found():
    assert len(printed()) > 25


@pytest.mark.parametrize(("page", "command"), printed())
def test_printed_commands_are_understood(page, command, monkeypatch, tmp_path):
    for kind in ("scene_source", "image_file"):
        monkeypatch.setattr(arguments, kind, str)
    monkeypatch.chdir(tmp_path)
    words = [VALUES.get(word, word) for word in shlex.split(re.sub(r"[\[\]]|\.\.\.|\| ", " ", command))]
    assert arguments.parse(words).command == words[0]
