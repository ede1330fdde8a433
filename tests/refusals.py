"""Tables of calls that are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

Row = tuple[type[Exception], str, Callable[[], Any]]


def refused(*rows: Row) -> None:
    """Make every call and see its error with a message that holds the given pattern."""
    for error, message, call in rows:
        with pytest.raises(error, match=message):
            call()
