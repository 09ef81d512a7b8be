"""The fast part of what the system does to a process: interrupts, kills, shared caches."""

import ctypes
import select
import signal
import sys
import threading
import time

import pytest

from lumigate.core.threads import Cancelled, run_chunks
from lumigate.headless import cli
from lumigate.headless.console import Terminal
from lumigate.headless.interrupts import Interrupts, ending_amid
from lumigate.headless.stress import processes
from lumigate.headless.stress.processes import interruption, killing, run


def test_an_interrupt_is_raised_and_written_down():
    before = signal.getsignal(signal.SIGINT)
    interrupts = Interrupts()
    with pytest.raises(KeyboardInterrupt), interrupts.listening():
        signal.raise_signal(signal.SIGINT)
    assert interrupts.heard
    assert signal.getsignal(signal.SIGINT) is before


def test_an_interrupt_that_a_callback_swallows_comes_again():
    hook, interrupts = sys.unraisablehook, Interrupts()
    callback = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))
    went_on, begin = False, time.monotonic()
    with pytest.raises(KeyboardInterrupt), interrupts.listening():
        callback()
        went_on = True
        select.select([], [], [], 30)
    assert went_on and time.monotonic() - begin < 25  # not only when the wait is over
    assert sys.unraisablehook is hook


def test_what_hears_nothing_is_ended_amid():
    """A call that swallows what is raised, as Blender does, is not over when its end is asked for."""
    interrupts, ended = Interrupts(), threading.Event()
    callback = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGTERM))
    with pytest.raises(KeyboardInterrupt), interrupts.listening():
        interrupts.end = ended.set
        with ending_amid():
            callback()
            assert ended.wait(30)
            select.select([], [], [], 30)
    assert signal.set_wakeup_fd(-1) == -1


def test_nothing_ends_amid_where_nobody_listens():
    interrupts = Interrupts()
    interrupts.end = pytest.fail
    with pytest.raises(KeyboardInterrupt):
        with interrupts.listening():
            pass
        with ending_amid():
            signal.raise_signal(signal.SIGINT)


def test_a_fault_that_an_interrupt_causes_is_an_interrupt(monkeypatch, capsys):
    def interrupted(argv, in_blender, interrupts):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("Error importing numpy") from None

    monkeypatch.setattr(cli, "_main", interrupted)
    assert cli.main([]) == 130
    assert capsys.readouterr().err == "lumigate: cancelled\n"


def test_a_fault_without_an_interrupt_is_shown(monkeypatch):
    def faulty(argv, in_blender, interrupts):
        raise ZeroDivisionError

    monkeypatch.setattr(cli, "_main", faulty)
    with pytest.raises(ZeroDivisionError):
        cli.main([])


def test_what_is_held_is_ended_and_the_next_progress_cancels():
    interrupts = Interrupts()
    terminal = Terminal.silent()
    terminal.interrupts = interrupts
    ended = []
    with interrupts.listening():
        with interrupts.held():
            signal.raise_signal(signal.SIGTERM)
            ended.append("file")
        with terminal.progress() as progress, pytest.raises(Cancelled):
            run_chunks(lambda begin, end: None, 4, 1, 1, lambda done: progress("view", done))
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
    assert ended == ["file"]


@pytest.mark.parametrize("moment", [0.05, 1.2])
def test_a_render_that_is_interrupted_leaves_everything_as_it_was(tmp_path, moment):
    assert interruption(tmp_path, moment) == ""


def test_a_render_that_is_killed_leaves_no_half_file(tmp_path):
    assert killing(tmp_path, 1.5) == ""


def test_one_cache_serves_many_processes_and_survives_a_kill():
    assert [line.case for line in processes.compilers(together=2, kills=1) if not line.passed] == []


def test_a_process_that_hangs_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "SECONDS", 0.2)
    ending = run("print('ready', flush=True); import time; time.sleep(60)", folder=tmp_path)
    assert ending.status == -signal.SIGKILL and "no end after" in ending.err


def test_a_torn_output_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "run", lambda *_, folder, **__: (folder / "out.exr").write_bytes(b"half"))
    assert killing(tmp_path, 0.0).startswith("torn")


def test_a_command_ends_though_something_still_refers_to_blender(tmp_path):
    # What typing remembers of a class keeps its module, and with it bpy; bpy 4.5 then ends in destructors that wait for ever.
    pin = "import typing; from lumigate.addon.extract.geometry import Collected; typing.Sequence[Collected]; "
    code = "print('ready', flush=True); import sys; sys.argv = ['lumigate', 'inspect', 'cornell']; "
    ending = run(pin + code + "from lumigate.headless.cli import program; program()", folder=tmp_path, TMPDIR=str(tmp_path))
    assert ending.status == 0, ending.err
    assert "will be wrong" in ending.out
    assert not list(tmp_path.iterdir())  # of Blender's: each command left a folder
