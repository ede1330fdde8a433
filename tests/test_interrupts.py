"""Ctrl-C at any moment of the command: status 130, one sentence, nothing half-written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from clplen import interrupts

ROOT = Path(__file__).parents[1]
# Sends SIGINT when a module is looked for, as sitecustomize of the child.
AT_IMPORT = """
import os, signal, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["INTERRUPT_AT"]:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
"""
AT_EXIT = """
import atexit, os, signal
atexit.register(os.kill, os.getpid(), signal.SIGINT)
"""
# A program named clplen with a command that is in a library for an hour, halfway in a file.
HANGING = """
import hashlib, multiprocessing, os, signal, threading, time
from contextlib import ExitStack
from clplen import cli
from clplen.files import filling, output_folder, replacing

@cli.main.command()
def hang():
    with ExitStack() as stack, replacing("out.tif") as temporary, filling("out.zarr") as folder:
        stack.enter_context(output_folder("new/inner"))
        children = multiprocessing.get_context("spawn")
        child = children.Process(target=time.sleep, args=(3600,))
        child.start()
        print(child.pid, flush=True)
        temporary.write_text("half")
        (folder / "0").write_text("half")
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        hashlib.pbkdf2_hmac("sha256", b"a", b"b", 2_000_000_000)

if __name__ == "__main__":
    cli.main(prog_name="clplen")
"""


def run(*words: str, cwd: Path, **env: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(cwd), str(ROOT)])
    return subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=60,
        env={**os.environ, "PYTHONPATH": path, **env},
    )


def check(done: subprocess.CompletedProcess[str]) -> None:
    assert done.returncode == interrupts.STATUS, done.stderr
    assert done.stderr == f"\n{interrupts.SENTENCE}\n"


@pytest.mark.parametrize("module", ["numpy", "clplen.lightfield.refocusing.focal_stacks"])
def test_while_modules_are_imported(tmp_path: Path, module: str):
    (tmp_path / "sitecustomize.py").write_text(AT_IMPORT)
    words = ("-m", "clplen", "stack", "none.h5", "-o", "out.tif")
    check(run(*words, cwd=tmp_path, INTERRUPT_AT=module))
    assert {file.name for file in tmp_path.iterdir()} <= {"sitecustomize.py", "__pycache__"}


def test_while_the_interpreter_ends(tmp_path: Path):
    (tmp_path / "sitecustomize.py").write_text(AT_EXIT)
    done = run("-m", "clplen", "--version", cwd=tmp_path)
    assert done.stdout.startswith("clplen, version")
    check(done)


def test_in_a_library_that_does_not_return(tmp_path: Path):
    """Kernels, transforms and compressors are waited for in C, where Python raises nothing."""
    script = tmp_path / "clplen"
    script.write_text(HANGING)
    done = run(str(script), "hang", cwd=tmp_path)
    check(done)
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)
    assert [file.name for file in tmp_path.iterdir()] == ["clplen"]


def test_other_programs_keep_their_own_way():
    assert not interrupts.is_command()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_the_command_is(monkeypatch: pytest.MonkeyPatch):
    for words, expected in [
        (["python", "-m", "clplen", "stack"], True),
        (["/usr/bin/clplen", "stack"], True),
        (["python", "-m", "pytest", "clplen"], False),
        (["python", "study.py", "clplen"], False),
        (["python"], False),
    ]:
        monkeypatch.setattr(sys, "orig_argv", words)
        monkeypatch.setattr(sys, "argv", [word for word in words if word != "python"] or [""])
        assert interrupts.is_command() is expected


def test_a_command_that_the_shell_shields_from_ctrl_c_goes_on():
    """Shells without job control start what runs in the background so."""
    code = (
        "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); "
        "sys.orig_argv = ['python', '-m', 'clplen']; import clplen.interrupts as interrupts; "
        "os.kill(os.getpid(), signal.SIGINT)\n"
        "with interrupts.unwinding(): os.kill(os.getpid(), signal.SIGINT)\n"
        "print('went on')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == "went on\n", done.stderr
