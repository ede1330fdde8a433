"""The package zarr, versions 2 and 3, of the extra ``zarr``."""

from __future__ import annotations

from typing import Any

from clplen.errors import FormatError


def zarr_package(instead: str) -> Any:
    """The package, imported when it is needed.

    Parameters
    ----------
    instead : str
        What else serves, for the message: "use .h5".

    Raises
    ------
    FormatError
        If it is not installed.
    """
    try:
        import zarr
    except ImportError as error:
        raise FormatError(
            f'Zarr needs the package zarr: pip install "clplen[zarr]", or {instead}.'
        ) from error
    return zarr


def format_2(zarr: Any) -> dict[str, Any]:
    """What makes either version write format 2, which both read."""
    return {} if zarr.__version__.startswith("2.") else {"zarr_format": 2}
