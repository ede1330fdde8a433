"""HDF5 files that lead to other files: refused before anything of these is opened.

External links, external storage and virtual datasets name any file of the machine; links of user's
own classes are followed by programs that HDF5 loads.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py

from clplen.errors import FormatError

_INSIDE = (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT)


def require_own(file: h5py.File, path: Path) -> None:
    """Refuse a file that holds a link to another file, or samples that lie in one.

    Parameters
    ----------
    file : h5py.File
        Open.
    path : pathlib.Path
        For the message.

    Raises
    ------
    FormatError
        Naming the link or dataset.
    """

    def foreign_link(name: Any, info: Any) -> str | None:
        return None if info.type in _INSIDE else _text(name)

    named = file.id.links.visit(foreign_link, info=True)
    if named is not None:
        raise FormatError(f"{path}: {named!r} is a link to another file: bring them into one.")

    def foreign_samples(name: str, item: Any) -> str | None:
        is_foreign = isinstance(item, h5py.Dataset) and (item.is_virtual or item.external)
        return name if is_foreign else None

    named = file.visititems(foreign_samples)
    if named is not None:
        raise FormatError(
            f"{path}: the samples of {named!r} lie in other files: bring them into one."
        )


def _text(name: Any) -> str:
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
