"""HDF5 files that lead to other files: refused before anything of these is opened.

External links, external storage and virtual datasets name any file of the machine; links of user's
own classes are followed by programs that HDF5 loads.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py

from clplen.errors import FormatError


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
        Naming the link or dataset, and the other file.
    """

    def foreign_link(name: str, link: Any) -> tuple[str, str] | None:
        return (name, str(link.filename)) if isinstance(link, h5py.ExternalLink) else None

    linked = file.visititems_links(foreign_link)
    if linked is not None:
        raise FormatError(
            f"{path}: {linked[0]!r} is a link to another file, {linked[1]!r}: bring them into one."
        )

    def foreign_samples(name: str, item: Any) -> str | None:
        is_foreign = isinstance(item, h5py.Dataset) and (item.is_virtual or item.external)
        return name if is_foreign else None

    named = file.visititems(foreign_samples)
    if named is not None:
        raise FormatError(
            f"{path}: the samples of {named!r} lie in other files: bring them into one."
        )
