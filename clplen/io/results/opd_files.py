"""OPD maps in HDF5, and in Zemax listings for each field and wavelength."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clplen.cameras.optics.opd_maps import OPDMaps
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats.zemax_map import ZemaxMap, read_zemax_map
from clplen.io.store import hdf5_files
from clplen.io.store.opd_arrays import OPD, read_maps, write_maps


def write_opd_maps(path: PathLike, maps: OPDMaps, *, durable: bool = False) -> None:
    """Write OPD maps for `read_opd_maps`.

    Parameters
    ----------
    path : path-like
        Output file, ``.h5`` or ``.hdf5``.
    maps : OPDMaps
        OPD maps, stored as float64.
    durable : bool
        True to wait until the file is on disk, as in `clplen.files.replacing`.

    Raises
    ------
    ValueError, OSError
        If the suffix is unknown; if the file cannot be written.

    Examples
    --------
    >>> v, u = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17), indexing="ij")
    >>> maps = clplen.cameras.OPDMaps([[100e-9 * (v**2 + u**2)]], fields=[(0, 0)])  # in metres
    >>> clplen.io.write_opd_maps("lens.h5", maps)
    >>> clplen.io.read_opd_maps("lens.h5") == maps
    True
    """
    if Path(path).suffix.lower() not in hdf5_files.SUFFIXES:
        raise ValueError(f"path must end in .h5 for OPD maps, got {path}.")
    with hdf5_files.create_hdf5(path, durable=durable) as file:
        write_maps(hdf5_files.HDF5Container(file, path), OPD, maps)


def read_opd_maps(path: PathLike, *, max_bytes: int | None = None) -> OPDMaps:
    """Read the OPD maps of `write_opd_maps`, or of the camera of a raw image.

    Parameters
    ----------
    path : path-like
        HDF5 file of `write_opd_maps`, or of a raw image or light field with OPD maps.
    max_bytes : int, optional
        Largest allocation that the file may cause; default half of the free memory.

    Returns
    -------
    OPDMaps
        OPD maps, equal to those written.

    Raises
    ------
    FormatError
        If the file is damaged or has no OPD maps.

    Examples
    --------
    >>> v, u = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17), indexing="ij")
    >>> maps = clplen.cameras.OPDMaps([[100e-9 * (v**2 + u**2)]], fields=[(0, 0)])  # in metres
    >>> clplen.io.write_opd_maps("lens.h5", maps)
    >>> stored = clplen.io.read_opd_maps("lens.h5")
    >>> stored.paths.shape, f"{stored.path(0, 0, 532e-9, v=0, u=0.5) * 1e9:.1f} nm"
    ((1, 1, 17, 17), '25.0 nm')
    """
    path = Path(path)
    with hdf5_files.open_hdf5(path) as file:
        for name in (OPD, f"camera/{OPD}"):
            maps = read_maps(hdf5_files.HDF5Container(file, path), name, max_bytes)
            if maps is not None:
                return maps
        raise FormatError(
            f"{path} has no OPD maps (group {OPD!r}); it has {hdf5_files.contents(file)}."
        )


def read_zemax_opd(
    files: Sequence[Any],
    *,
    fields: Any,
    symmetric: bool = False,
    distortion: Any = None,
    pupil_shift: Any = None,
    pupil_distance: float | None = None,
    max_bytes: int | None = None,
) -> OPDMaps:
    """Read OPD maps from text listings of the Wavefront Map analysis of Zemax OpticStudio.

    The y axes agree. The OPD of Zemax is positive when ahead, ours when behind; the sign is
    changed. Save the maps without "Use Exit Pupil Shape" and without "Remove Tilt". If the tilt is
    removed, the path refers to the sphere about the centroid of the light, and ``distortion`` must
    describe that centroid.

    Parameters
    ----------
    files : sequence of path-like, or of sequences of them
        A file for each field, for a single wavelength; or such a sequence for each wavelength.
    fields : array_like
        Field positions as in `OPDMaps`, in the order of the files. A listing states angles or
        object heights, not image positions.
    symmetric : bool
        Flag as in `OPDMaps`: True for a rotationally symmetric lens.
    distortion, pupil_shift : array_like, optional
        Shifts as in `OPDMaps`, of shape (n_wavelengths, n_fields, 2) or (n_fields, 2): (y, x) of
        the chief ray relative to its field in metres, and of the pupil's centre in fractions of its
        radius.
    pupil_distance : float, optional
        Distance as in `OPDMaps` from the exit pupil to the image plane, in metres.
    max_bytes : int, optional
        Largest allocation of a file; default half of the free memory.

    Returns
    -------
    OPDMaps
        OPD maps, with ``pupil_diameter`` if all listings agree on the exit pupil within 1 %.

    Raises
    ------
    FormatError, ValueError
        If a file is not such a listing or files are inconsistent; errors of `OPDMaps`.

    Examples
    --------
    >>> v, u = np.meshgrid(np.linspace(1, -1, 17), np.linspace(-1, 1, 17), indexing="ij")
    >>> waves = np.where(np.hypot(v, u) <= 1, 0.5 * (v**2 + u**2), 0)
    >>> head = "0.5500 um at 0.0000, 0.0000 (deg)\\nPupil grid size: 17 by 17"
    >>> np.savetxt("map.txt", waves, header=head, comments="")  # as OpticStudio lists it
    >>> maps = clplen.io.read_zemax_opd(["map.txt"], fields=[(0, 0)])
    >>> f"{maps.path(0, 0, 550e-9, v=0, u=0.5) * 1e9:.2f} nm"  # -0.125 waves: ahead
    '-68.75 nm'
    """
    rows = [files] if all(isinstance(file, str | Path) for file in files) else files
    maps = [[read_zemax_map(file, max_bytes=max_bytes) for file in row] for row in rows]
    if not maps or not maps[0] or len({len(row) for row in maps}) > 1:
        raise ValueError("files must have at least one file and equally many for each wavelength.")
    flat = [item for row in maps for item in row]
    shapes = {item.path.shape for item in flat}
    if len(shapes) > 1:
        listing = ", ".join(f"{v} x {u}" for v, u in sorted(shapes))
        raise FormatError(f"All maps must have the same sampling, got {listing}.")
    for row, row_files in zip(maps, rows, strict=True):
        if len({item.wavelength for item in row}) > 1:
            colours = ", ".join(f"{item.wavelength * 1e9:g}" for item in row)
            raise FormatError(
                f"Maps in a row must have the same wavelength, got {colours} nm from "
                f"{', '.join(Path(file).name for file in row_files)}: sort the files by "
                "wavelength, then by field."
            )
    return OPDMaps(
        np.array([[item.path for item in row] for row in maps]),
        fields=fields,
        wavelengths=[row[0].wavelength for row in maps],
        symmetric=symmetric,
        distortion=distortion,
        pupil_shift=pupil_shift,
        pupil_distance=pupil_distance,
        pupil_diameter=_diameter(flat),
    )


def _diameter(maps: Sequence[ZemaxMap]) -> float | None:
    """Return the diameter of the exit pupil if all maps agree within 1 %, or None."""
    diameters = [item.pupil_diameter for item in maps if item.pupil_diameter]
    agree = len(diameters) == len(maps) and max(diameters) <= 1.01 * min(diameters)
    return float(np.mean(diameters)) if agree else None
