"""OME-TIFF of a time series of volumes, TZYX: under a hidden name until its last volume is there.

A TIFF names all its pages in advance: the file is laid out first, each batch of volumes takes its
place, and a small file beside it counts those that the disk has. Whole, it takes its own name.
"""

from __future__ import annotations

import json
import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from clplen.files import replacing, said_of
from clplen.io.store.ome_tiff import BIG, ome_metadata
from clplen.io.store.picture_blocks import Array
from clplen.io.store.picture_series import describe_series, ome_of
from clplen.io.store.series_layout import Record, SeriesLayout, checked_series
from clplen.outputs import MARK

_NAMESPACE = "http://www.openmicroscopy.org/Schemas/OME/2016-06"


class GrowingTiff:
    """A series in an OME-TIFF.

    Attributes
    ----------
    records : list of dict
        What is said of each volume that is there.
    """

    def __init__(self, path: Path, layout: SeriesLayout) -> None:
        self.path, self.layout = path, layout
        self.records: list[Record] = []
        self._start = 0

    @property
    def nbytes(self) -> int:
        """Bytes of all volumes."""
        return 4 * self.layout.frames * math.prod(self.layout.shape)

    @staticmethod
    def stored(path: Path) -> tuple[dict[str, Any], list[Record]]:
        """Description and records of what is there, whole or not; empty of anything else."""
        with suppress(Exception):  # what others wrote, or nothing
            if _is_begun(path):
                text = _counted(path).read_text(encoding="utf-8")
            else:
                text = json.dumps(describe_series(path))
            about, records = checked_series(json.loads(text))
            about.pop("software", None)
            return about, records
        return {}, []

    def begin(self) -> None:
        """Lay out the file, of volumes of 0; what was there under its own name stays so far."""
        layout = self.layout
        places = () if layout.depth is not None else layout.planes * layout.frames
        metadata = ome_metadata("TZYX", layout.about, layout.voxel, layout.depth, places)
        hidden = _hidden(self.path)
        with said_of(self.path):
            hidden.unlink(missing_ok=True)  # a link could lead to a file of others
            with tifffile.TiffWriter(hidden, ome=True, bigtiff=self.nbytes > BIG) as writer:
                self._start, _ = writer.write(
                    shape=(layout.frames, *layout.shape),
                    dtype=np.float32,
                    photometric="minisblack",
                    metadata=metadata,
                    software=MARK,
                    returnoffset=True,
                )
        self._count()

    def resume(self, records: list[Record]) -> None:
        """Go on after so many volumes."""
        self.records = list(records)
        self._start = self._offset()
        self._count()

    def whole(self, records: list[Record]) -> int:
        """Volumes that are there: all of `records`, or none where the file is damaged."""
        return len(records) if self.holds(len(records) - 1) else 0

    def holds(self, t: int) -> bool:
        """Return whether the file has all bytes of the volume of a time point."""
        try:
            wanted = self._offset() + 4 * (t + 1) * math.prod(self.layout.shape)
            return self._file().stat().st_size >= wanted
        except Exception:  # tifffile raises all kinds on damaged files
            return False

    def append(self, volumes: Sequence[Array], records: Sequence[Record]) -> None:
        """Put volumes, float32 (planes, y, x), to their places."""
        nbytes = 4 * math.prod(self.layout.shape)
        with said_of(self.path), _hidden(self.path).open("r+b") as file:
            file.seek(self._start + nbytes * len(self.records))
            for volume in volumes:
                file.write(np.ascontiguousarray(volume, "<f4").data)
            file.flush()
            os.fsync(file.fileno())
        self.records += records
        self._count()

    def read(self, t: int) -> Array:
        """The volume of a time point, as it was given."""
        shape = self.layout.shape
        count = math.prod(shape)
        offset = self._offset() + 4 * count * t
        return np.fromfile(self._file(), "<f4", count, offset=offset).reshape(shape)

    def end(self) -> None:
        """Give the whole file what is said of its volumes, and its own name."""
        hidden = _hidden(self.path)
        with said_of(self.path):
            root = ome_of(hidden)
            ET.register_namespace("", _NAMESPACE)
            for item in root.iter():
                if item.tag.endswith("Description"):
                    item.text = json.dumps({**self.layout.about, "records": self.records})
            text = ET.tostring(root, encoding="unicode")
            tifffile.tiffcomment(hidden, ('<?xml version="1.0" encoding="UTF-8"?>' + text).encode())
            with hidden.open("r+b") as file:
                os.fsync(file.fileno())
            os.replace(hidden, self.path)
            _counted(self.path).unlink(missing_ok=True)

    def _file(self) -> Path:
        return _hidden(self.path) if _is_begun(self.path) else self.path

    def _offset(self) -> int:
        with tifffile.TiffFile(self._file(), is_ome=False) as file:
            return int(file.pages.first.dataoffsets[0])

    def _count(self) -> None:
        with replacing(_counted(self.path), durable=True) as temporary:
            about = {**self.layout.about, "records": self.records, "software": MARK}
            temporary.write_text(json.dumps(about), encoding="utf-8")


def _hidden(path: Path) -> Path:
    """The file while volumes are missing."""
    return path.with_name(f".{path.stem}.unfinished{path.suffix}")


def _counted(path: Path) -> Path:
    """What counts its volumes."""
    return path.with_name(f".{path.stem}.unfinished.json")


def _is_begun(path: Path) -> bool:
    """Return whether there is a file with missing volumes, and what counts them; no links."""
    return all(one.is_file() and not one.is_symlink() for one in (_hidden(path), _counted(path)))
