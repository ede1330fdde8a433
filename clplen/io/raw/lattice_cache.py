"""Lattices of lenslets that were found before, so that a picture is searched once.

A lattice is kept under the digest of the picture, the dark frame, the words of the search and the
code that searches, in clplen's cache folder.
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


def kept_lattice(
    picture: Frame,
    *,
    dark: Frame | None = None,
    kind: str | None = None,
    bayer: str | tuple[tuple[str, ...], ...] | None = None,
    pitch: float | None = None,
) -> Lattice:
    """The lattice of a white image: from the cache, or by `estimate_lattice`, and kept then."""
    words = {"kind": kind, "bayer": bayer, "pitch": pitch}
    file = cache_dir() / _FOLDER / f"{_digest(picture, dark, words)}.json"
    known = _read(file)
    if known is not None:
        return known
    found = estimate_lattice(picture, dark=dark, kind=kind, bayer=bayer, pitch=pitch)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        found.save(file)
    except OSError:  # it is sought again
        pass
    return found


def _digest(picture: Frame, dark: Frame | None, words: dict[str, Any]) -> str:
    digest = hashlib.blake2b(json.dumps(words, sort_keys=True).encode(), digest_size=16)
    for frame in (picture, dark):
        if frame is not None:
            digest.update(f"{frame.shape}{frame.dtype.str}".encode())
            digest.update(np.ascontiguousarray(frame).data)
    for source in sorted(Path(lattice_fit.__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _read(file: Path) -> Lattice | None:
    """A lattice that was kept; None where there is none, or the file is damaged."""
    try:
        return Lattice.load(file)
    except FormatError:
        return None
