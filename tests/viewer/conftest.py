"""Chromium for the tests of pages; without it they are skipped and say what is missing."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import accuracy_viewer
import pytest

INSTALL = "install it: apt-get install chromium && pip install '.[browser]'"


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A browser without a network."""
    if not Path(accuracy_viewer.CHROMIUM).is_file():
        pytest.skip(f"no Chromium at {accuracy_viewer.CHROMIUM}; {INSTALL}")
    if find_spec("playwright") is None:
        pytest.skip(f"no playwright; {INSTALL}")
    with accuracy_viewer.browser() as opened:
        yield opened
