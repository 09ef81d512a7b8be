"""The job templates of other farms: their syntax, and that what they call is our command line."""

import importlib.util
import json
import shutil
import subprocess
from pathlib import Path

import esprima
import pytest

import lumigate
from lumigate.headless import arguments

TEMPLATES = Path(lumigate.__file__).parent / "headless" / "farm" / "templates"
FLAMENCO = TEMPLATES / "lumigate.flamenco.js"


def opencue():
    spec = importlib.util.spec_from_file_location("opencue_lumigate", TEMPLATES / "opencue_lumigate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def call_of(tree):
    """The words of the array that Flamenco's `args` begins with, and the names of the functions."""
    texts, functions = [], set()

    def walk(node):
        if isinstance(node, list):
            for item in node:
                walk(item)
        elif hasattr(node, "type"):
            if node.type == "Property" and getattr(node.key, "name", "") == "args":
                first = node.value.callee.object  # ["render", ...].concat(extra)
                texts.extend(item.value if item.type == "Literal" else item for item in first.elements)
            if node.type == "FunctionDeclaration":
                functions.add(node.id.name)
            for name in vars(node):
                walk(getattr(node, name))

    walk(tree.body)
    return texts, functions


def test_flamenco_script_is_javascript_that_calls_our_command_line(tmp_path, monkeypatch):
    words, functions = call_of(esprima.parseScript(FLAMENCO.read_text(encoding="utf-8")))
    assert "compileJob" in functions
    (tmp_path / "shot.blend").touch()
    values = {"blendfile": str(tmp_path / "shot.blend"), "output_file": str(tmp_path / "out.exr"), "frames": "1-100", "part": "1-32"}
    argv = [
        word if isinstance(word, str) else values[word.property.name if word.type == "MemberExpression" else word.name] for word in words
    ]
    parsed = arguments.parse(argv)
    assert (parsed.frames, parsed.part, parsed.skip_existing) == (range(1, 101), range(1, 33), True)


@pytest.mark.parametrize(("frames", "count"), [("1-100", 4), ("-3-5", 1)])
def test_flamenco_script_runs_where_there_is_a_javascript(frames, count):
    node = shutil.which("node")
    if node is None:
        assert "const JOB_TYPE" in FLAMENCO.read_text(encoding="utf-8")  # parsed by the test above
        return
    settings = {"frames": frames, "chunk_size": 32, "blendfile": "s.blend", "output_file": "o.exr", "options": "--vpls  9", "lumigate": "l"}
    script = (
        FLAMENCO.read_text(encoding="utf-8")
        + "const tasks = []; const author = {Task: (n, t) => ({n, c: [], addCommand(x) { this.c.push(x); }}), Command: (n, p) => p};"
        + f"compileJob({{settings: {json.dumps(settings)}, addTask: (t) => tasks.push(t)}}); console.log(JSON.stringify(tasks));"
    )
    tasks = json.loads(subprocess.run([node, "-e", script], capture_output=True, text=True, check=True).stdout)
    assert len(tasks) == count
    assert tasks[0]["c"][0]["args"][-2:] == ["--vpls", "9"]


def test_opencue_script_calls_our_command_line(tmp_path):
    (tmp_path / "shot.blend").touch()
    made = opencue().commands(str(tmp_path / "shot.blend"), str(tmp_path / "o.####.exr"), "1-70", 32, ["--vpls", "9"])
    parsed = [arguments.parse(command[1:]) for command in made]
    assert [p.part for p in parsed] == [range(1, 33), range(33, 65), range(65, 71)]
    assert parsed[0].settings.vpls == 9


def test_opencue_script_refuses_what_is_no_range():
    with pytest.raises(ValueError, match="is not FIRST-LAST"):
        opencue().commands("s.blend", "o.exr", "1..5", 32, [])
