"""Progress bars of tqdm, shown by long functions in notebooks."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import Any, TypeVar

Target = TypeVar("Target", bound=Callable[..., Any])
Progress = Callable[[int, int], None]

_DELAY = 1.0  # seconds before a bar appears, so that quick calls show none
_is_active: ContextVar[bool] = ContextVar("is_active", default=False)


def in_notebook() -> bool:
    """Return True if this process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return getattr(shell, "kernel", None) is not None


def progress_bar(**options: Any) -> Any:
    """Create a bar of tqdm: a widget in notebooks, text elsewhere."""
    if not in_notebook():
        from tqdm import tqdm

        return tqdm(**options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without ipywidgets tqdm.auto falls back to text
        from tqdm.auto import tqdm as notebook_tqdm

        return notebook_tqdm(**options)


def notebook_bar(name: str) -> Callable[[Target], Target]:
    """Decorate a function with an argument ``progress`` to show a bar in notebooks.

    The caller's own ``progress``, other programs and nested calls are not affected.
    """

    def decorate(function: Target) -> Target:
        @wraps(function)
        def wrapper(*arguments: Any, **keywords: Any) -> Any:
            if _is_active.get() or not in_notebook():
                return function(*arguments, **keywords)
            token = _is_active.set(True)
            try:
                if keywords.get("progress") is not None:
                    return function(*arguments, **keywords)
                with _bar(name) as progress:
                    return function(*arguments, **keywords | {"progress": progress})
            finally:
                _is_active.reset(token)

        return wrapper  # type: ignore[return-value]

    return decorate


@contextmanager
def _bar(name: str) -> Iterator[Progress]:
    """Yield a function ``progress(done, total)`` of a bar that closes with the block."""
    bars: list[Any] = []

    def progress(done: int, total: int) -> None:
        if not bars:
            bars.append(progress_bar(total=total, desc=name, delay=_DELAY, leave=False))
        bars[0].total = total
        bars[0].update(done - bars[0].n)

    try:
        yield progress
    finally:
        for bar in bars:
            bar.close()
