"""Runs figure scripts one after the other in a process, so that each need not import everything."""

from __future__ import annotations

import io
import os
import runpy
import sys
import traceback
import warnings
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Done:
    """What a script left: its status and what it printed."""

    returncode: int
    stdout: str
    stderr: str


def run_script(script: Path, arguments: tuple[str, ...], folder: Path) -> Done:
    """Run a script as ``__main__`` from another folder."""
    out, err, status = io.StringIO(), io.StringIO(), 0
    old = sys.argv, sys.path[:]
    os.chdir(folder)
    sys.argv = [str(script), *arguments]
    sys.path.insert(0, str(script.parent))
    with redirect_stdout(out), redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("always")
        try:
            runpy.run_path(str(script), run_name="__main__")
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        except Exception:
            traceback.print_exc(file=err)
            status = 1
    sys.argv, sys.path[:] = old
    return Done(status, out.getvalue(), err.getvalue())
