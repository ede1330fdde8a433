"""OME-TIFF of a time series of volumes (TZYX), under a hidden name until it is complete.

A TIFF lists all its pages in advance: the file is laid out first, then filled batch by batch. A
small file beside it counts the volumes on disk. The complete file is renamed.
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

from clplen.files import replacing, write_errors
from clplen.io.store.ome_tiff import BIG, ome_metadata
from clplen.io.store.picture_blocks import Array
from clplen.io.store.picture_series import describe_series, ome_of
from clplen.io.store.series_layout import Record, SeriesLayout, checked_series
from clplen.outputs import MARK

_NAMESPACE = "http://www.openmicroscopy.org/Schemas/OME/2016-06"


class GrowingTiff:
    """Time series of volumes in an OME-TIFF.

    Attributes
    ----------
    records : list of dict
        Description of each stored volume.
    """

    def __init__(self, path: Path, layout: SeriesLayout) -> None:
        self.path, self.layout = path, layout
        self.records: list[Record] = []
        self._start = 0

    @property
    def nbytes(self) -> int:
        """Size of all volumes in bytes."""
        return 4 * self.layout.frames * math.prod(self.layout.shape)

    @staticmethod
    def stored(path: Path) -> tuple[dict[str, Any], list[Record]]:
        """Return description and records of a series on disk, complete or not; empty otherwise."""
        with suppress(Exception):  # foreign or missing file
            if _is_begun(path):
                text = _progress_file(path).read_text(encoding="utf-8")
            else:
                text = json.dumps(describe_series(path))
            about, records = checked_series(json.loads(text))
            about.pop("software", None)
            return about, records
        return {}, []

    def begin(self) -> None:
        """Create the file with volumes of zeros; an existing file keeps its name until the end."""
        layout = self.layout
        planes = () if layout.depth is not None else layout.planes * layout.frames
        metadata = ome_metadata("TZYX", layout.about, layout.voxel, layout.depth, planes)
        hidden = _hidden(self.path)
        with write_errors(self.path):
            hidden.unlink(missing_ok=True)  # a link could point elsewhere
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
        """Continue after the volumes of ``records``."""
        self.records = list(records)
        self._start = self._offset()
        self._count()

    def count_complete(self, records: list[Record]) -> int:
        """Return the number of complete volumes: all of ``records``, or 0 for a damaged file."""
        return len(records) if self.holds(len(records) - 1) else 0

    def holds(self, t: int) -> bool:
        """Return True if the file has all bytes of the volume at time point ``t``."""
        try:
            required = self._offset() + 4 * (t + 1) * math.prod(self.layout.shape)
            return self._file().stat().st_size >= required
        except Exception:  # tifffile raises any exception on damaged files
            return False

    def append(self, volumes: Sequence[Array], records: Sequence[Record]) -> None:
        """Write volumes, float32 of shape (planes, y, x), into the file."""
        nbytes = 4 * math.prod(self.layout.shape)
        with write_errors(self.path), _hidden(self.path).open("r+b") as file:
            file.seek(self._start + nbytes * len(self.records))
            for volume in volumes:
                file.write(np.ascontiguousarray(volume, "<f4").data)
            file.flush()
            os.fsync(file.fileno())
        self.records += records
        self._count()

    def read(self, t: int) -> Array:
        """Return the volume of a time point."""
        shape = self.layout.shape
        count = math.prod(shape)
        offset = self._offset() + 4 * count * t
        return np.fromfile(self._file(), "<f4", count, offset=offset).reshape(shape)

    def end(self) -> None:
        """Write the records into the complete file, and rename it."""
        hidden = _hidden(self.path)
        with write_errors(self.path):
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
            _progress_file(self.path).unlink(missing_ok=True)

    def _file(self) -> Path:
        return _hidden(self.path) if _is_begun(self.path) else self.path

    def _offset(self) -> int:
        with tifffile.TiffFile(self._file(), is_ome=False) as file:
            return int(file.pages.first.dataoffsets[0])

    def _count(self) -> None:
        with replacing(_progress_file(self.path), durable=True) as temporary:
            about = {**self.layout.about, "records": self.records, "software": MARK}
            temporary.write_text(json.dumps(about), encoding="utf-8")


def _hidden(path: Path) -> Path:
    """Return the name of the incomplete file."""
    return path.with_name(f".{path.stem}.unfinished{path.suffix}")


def _progress_file(path: Path) -> Path:
    """Return the name of the file that counts the stored volumes."""
    return path.with_name(f".{path.stem}.unfinished.json")


def _is_begun(path: Path) -> bool:
    """Return True if an incomplete file and its progress file exist and are not links."""
    files = (_hidden(path), _progress_file(path))
    return all(file.is_file() and not file.is_symlink() for file in files)
