"""What the command line says of failures: one sentence, in the words that a user types."""

from __future__ import annotations

import re
import sys
import warnings
from typing import Any

import click

from clplen import interrupts
from clplen.errors import ClplenError

# Python's words, and what the command line has for them.
_TYPED = (
    (r"\ballow_missing=True gives", "--allow-missing gives"),
    (r"\bforce=True", "--force"),
    (r"\bviews=\((\w+), (\w+)\)", r"--views \1 \2"),
    (r"\bpattern=(?=')", "--pattern "),
    (r"\border='(\w+)'", r"--order \1"),
    (
        r"\b(pattern|views|flip_v|flip_u|swap_uv|allow_missing|order|dataset|positions|srgb|white|"
        r"dark|grid|image|step|lattice|bayer|demosaic|devignette|max_bytes)=",
        r"--\1",
    ),
    (r"give spacing=\(dv, du, dy, dx\), or use disparity", "use --disparities"),
    (r" and give their views weight 0 \(weights=\)", ""),
    (r"--(swap|flip|allow|max)_", r"--\1-"),
    (r"\bms=(?=\W)", "--m"),
    (r"\bmethod='([\w-]+)'(?: or '([\w-]+)')", r"--method \1 or \2"),
    (r"\bmethod='([\w-]+)'", r"--method \1"),
    (r"\bor 'auto'", "or auto"),
    (r"\breplace it \(replace=True\)", "remove it"),
    (r"\ba larger pad\b", "a larger --pad"),
    (r"\bby support=", "by --support"),
)


class Commands(click.Group):
    """Commands whose expected failures are one sentence, not a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        with interrupts.unwinding(), warnings.catch_warnings():
            warnings.showwarning = _show_warning
            try:
                return super().invoke(ctx)
            except KeyboardInterrupt:
                if interrupts.is_command():
                    interrupts.leave()
                click.echo(f"\n{interrupts.SENTENCE}", err=True)
                ctx.exit(interrupts.STATUS)
            except BrokenPipeError:
                raise
            except (ClplenError, ValueError, OSError, MemoryError) as error:
                raise click.ClickException(sentence(error)) from error
            except _opencl_errors() as error:
                reason = (str(error).splitlines() or [type(error).__name__])[0]
                raise click.ClickException(
                    f"OpenCL failed ({reason}): run `clplen devices --check` to see what works, or "
                    "choose another device by --device."
                ) from error


def _opencl_errors() -> tuple[type[Exception], ...]:
    """What OpenCL raises, where it is in use."""
    opencl = sys.modules.get("pyopencl")
    return () if opencl is None else (opencl.Error,)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    note(str(message))


def note(text: str) -> None:
    """Say something on standard error that does not end the command."""
    click.echo(f"Note: {text}", err=True)


def sentence(error: BaseException) -> str:
    """What went wrong, without a compiler's log and in the words of the command line."""
    if isinstance(error, MemoryError):
        detail = str(error).rstrip(".")
        return "This computer has not enough memory" + (f": {detail}." if detail else " for it.")
    if isinstance(error, OSError) and error.errno is not None:
        return str(error)
    return typed(str(error.args[0]) if error.args else type(error).__name__)


def typed(text: str) -> str:
    """A sentence of the package in the words of the command line."""
    for python, words in _TYPED:
        text = re.sub(python, words, text)
    return text
