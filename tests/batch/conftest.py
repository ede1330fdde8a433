"""A small job."""

from __future__ import annotations

from pathlib import Path

import batchworks
import pytest


@pytest.fixture
def small(tmp_path: Path) -> tuple[Path, list[Path]]:
    """A job over six small light fields."""
    files = batchworks.write_inputs(tmp_path / "in", 6)
    return batchworks.write_job(tmp_path), files
