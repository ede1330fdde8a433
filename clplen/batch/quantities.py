"""Values of job files: planes, sizes of memory, apertures, names of what is read."""

from __future__ import annotations

import re
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

_UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_UNITS |= {"KIB": 1 << 10, "MIB": 1 << 20, "GIB": 1 << 30, "TIB": 1 << 40}
_SIZE = re.compile(r"\s*([0-9]+(?:\.[0-9]+)?)\s*([KMGT]?I?B?)\s*", re.IGNORECASE)
_MOST_PLANES = 100_000


def bytes_of(value: Any) -> int:
    """A size of memory, as 2000000, "512 MiB" or "4 GB", in bytes.

    Raises
    ------
    ValueError
        If it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise ValueError('must be a whole number of bytes or a size such as "4 GiB"')
    found = _SIZE.fullmatch(str(value))
    unit = found[2].upper() if found else ""
    if found is None or unit not in _UNITS:
        raise ValueError('must be a whole number of bytes or a size such as "512 MiB" or "4 GB"')
    return int(float(found[1]) * _UNITS[unit])


def planes_of(value: Any) -> list[float]:
    """Planes as a list, or as START:STOP:N, both ends included.

    Raises
    ------
    ValueError
        If it is neither.
    """
    if isinstance(value, str):
        return _range(value)
    if not isinstance(value, list) or not value:
        raise ValueError('must be a list of numbers or "START:STOP:N", such as "-1:1:41"')
    if any(isinstance(one, bool) or not isinstance(one, int | float) for one in value):
        raise ValueError("must hold numbers only")
    planes = [float(one) for one in value]
    if not np.isfinite(planes).all():
        raise ValueError("must hold finite numbers only")
    return planes


def _range(text: str) -> list[float]:
    parts = text.split(":")
    try:
        start, stop, count = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError):
        count = -1
    if len(parts) != 3 or not 1 <= count <= _MOST_PLANES or not np.isfinite([start, stop]).all():
        raise ValueError(f'must be "START:STOP:N" with 1 to {_MOST_PLANES} planes')
    if (count == 1) != (start == stop):
        raise ValueError("needs at least 2 planes between two different ends")
    return [float(plane) for plane in np.linspace(start, stop, count)]


def aperture_of(value: Any) -> int | float | str:
    """Views across, a fraction of the diameter, or an f-number such as "f/66"."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and value > 0
    if is_number or (isinstance(value, str) and re.fullmatch(r"f/\d+(\.\d+)?", value)):
        return value
    raise ValueError('must be views across (9), a fraction of the diameter (0.5) or "f/66"')


Size = Annotated[int, BeforeValidator(bytes_of), Field(ge=1)]
Planes = Annotated[list[float], BeforeValidator(planes_of)]
Aperture = Annotated[Any, BeforeValidator(aperture_of)]
