"""Cache of estimated lenslet lattices.

The key is the digest of the picture, the dark frame, the options of the estimate and its source
code. Files are in clplen's cache folder.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from clplen.compute.drivers.environment import cache_dir
from clplen.errors import FormatError
from clplen.lightfield.calibration import lattice_fit
from clplen.lightfield.calibration.lattice_fit import estimate_lattice
from clplen.lightfield.raw.lenslet_lattice import Lattice

Frame = np.ndarray[Any, Any]

_FOLDER = "lattices"


def cached_lattice(
    picture: Frame,
    *,
    dark: Frame | None = None,
    kind: str | None = None,
    bayer: str | tuple[tuple[str, ...], ...] | None = None,
    pitch: float | None = None,
) -> Lattice:
    """Return the lattice of a white image from the cache, or estimate and cache it."""
    options = {"kind": kind, "bayer": bayer, "pitch": pitch}
    file = cache_dir() / _FOLDER / f"{_digest(picture, dark, options)}.json"
    lattice = _read(file)
    if lattice is not None:
        return lattice
    lattice = estimate_lattice(picture, dark=dark, kind=kind, bayer=bayer, pitch=pitch)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        lattice.save(file)
    except OSError:  # estimated again next time
        pass
    return lattice


def _digest(picture: Frame, dark: Frame | None, options: dict[str, Any]) -> str:
    digest = hashlib.blake2b(json.dumps(options, sort_keys=True).encode(), digest_size=16)
    for frame in (picture, dark):
        if frame is not None:
            digest.update(f"{frame.shape}{frame.dtype.str}".encode())
            digest.update(np.ascontiguousarray(frame).data)
    for source in sorted(Path(lattice_fit.__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _read(file: Path) -> Lattice | None:
    """Return a cached lattice; None if it is missing or damaged."""
    try:
        return Lattice.load(file)
    except FormatError:
        return None
