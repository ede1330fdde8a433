"""The package zarr, version 3, of the extra ``zarr``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from clplen.errors import FormatError

FORMAT_2: dict[str, Any] = {"zarr_format": 2}  # what is written, and what most programs read


def zarr_package(instead: str) -> Any:
    """The package, imported when it is needed.

    Parameters
    ----------
    instead : str
        What else serves, for the message: "use .h5".

    Raises
    ------
    FormatError
        If it is not installed, or is a version before 3.
    """
    try:
        import zarr
    except ImportError as error:
        raise FormatError(
            f'Zarr needs the package zarr: pip install "clplen[zarr]", or {instead}.'
        ) from error
    if zarr.__version__.startswith("2."):
        raise FormatError(
            f"Zarr needs the package zarr 3 (Python 3.11 or newer), not {zarr.__version__}, which "
            f'runs code that data contain: pip install "clplen[zarr]", or {instead}.'
        )
    return zarr


@contextmanager
def opened_store(path: Path, instead: str, max_bytes: int | None = None) -> Iterator[Any]:
    """The root of a store to read, a group or an array, whose metadata and chunks are checked.

    Parameters
    ----------
    path : pathlib.Path
        A folder or a zip archive.
    instead : str
        As for `zarr_package`.
    max_bytes : int, optional
        Largest member of an archive; default half of the free memory.

    Raises
    ------
    FormatError
        As `clplen.io.store.zarr_store.open_store`, and if the package zarr is not installed.
    """
    zarr_package(instead)
    from clplen.io.store.zarr_store import open_store

    with open_store(path, max_bytes) as root:
        yield root
