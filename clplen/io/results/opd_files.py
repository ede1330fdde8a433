"""Files of OPD maps: HDF5, and listings of Zemax, one for each field and wavelength."""

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
    """Write OPD maps, so that `read_opd_maps` gives the same back.

    Parameters
    ----------
    path : path-like
        ``.h5`` or ``.hdf5``.
    maps : OPDMaps
        Stored whole, as float64.
    durable : bool
        Whether to wait until the disk has the file, as in `clplen.files.replacing`.

    Raises
    ------
    ValueError, OSError
        If the suffix is another one; if the file cannot be written.

    Examples
    --------
    >>> v, u = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17), indexing="ij")
    >>> maps = clplen.cameras.OPDMaps([[100e-9 * (v**2 + u**2)]], fields=[(0, 0)])  # in metres
    >>> clplen.io.write_opd_maps("lens.h5", maps)
    >>> clplen.io.read_opd_maps("lens.h5") == maps
    True
    """
    if Path(path).suffix.lower() not in hdf5_files.SUFFIXES:
        raise ValueError(f"OPD maps are written as .h5, not as {path}.")
    with hdf5_files.created(path, durable=durable) as file:
        write_maps(hdf5_files.HDF5Container(file, path), OPD, maps)


def read_opd_maps(path: PathLike, *, max_bytes: int | None = None) -> OPDMaps:
    """Read what `write_opd_maps` wrote, or the maps of the camera of a raw image.

    Parameters
    ----------
    path : path-like
        HDF5 of `write_opd_maps`, or of a raw image or a light field with such a camera.
    max_bytes : int, optional
        Largest allocation that the file may ask for; default half of the free memory.

    Returns
    -------
    OPDMaps
        Equal to what was written.

    Raises
    ------
    FormatError
        If it is damaged, or holds no OPD maps.

    Examples
    --------
    >>> v, u = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17), indexing="ij")
    >>> maps = clplen.cameras.OPDMaps([[100e-9 * (v**2 + u**2)]], fields=[(0, 0)])  # in metres
    >>> clplen.io.write_opd_maps("lens.h5", maps)
    >>> found = clplen.io.read_opd_maps("lens.h5")
    >>> found.paths.shape, f"{found.path(0, 0, 532e-9, v=0, u=0.5) * 1e9:.1f} nm"
    ((1, 1, 17, 17), '25.0 nm')
    """
    path = Path(path)
    with hdf5_files.opened(path) as file:
        for name in (OPD, f"camera/{OPD}"):
            maps = read_maps(hdf5_files.HDF5Container(file, path), name, max_bytes)
            if maps is not None:
                return maps
        raise FormatError(
            f"{path} holds no OPD maps, no group {OPD!r}; it holds {hdf5_files.contents(file)}."
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
    """Read OPD maps from listings of Zemax OpticStudio's analysis Wavefront Map, saved as text.

    The prescription's y is ours. Its OPD is ahead where it is positive, ours is behind, and is
    turned round. Save the maps with the exit pupil's shape left alone and the tilt kept (not "Use
    Exit Pupil Shape", not "Remove Tilt"); where the tilt is removed, the path is from the sphere
    about the light's middle, which ``distortion`` then is that of.

    Parameters
    ----------
    files : sequence of path-like, or of sequences of them
        One for each field, of one wavelength; or for each wavelength such a sequence.
    fields : array_like
        As of `OPDMaps`, in the order of the files. A listing tells angles or object heights, no
        place on the image.
    symmetric : bool
        As of `OPDMaps`: whether the lens is rotationally symmetric.
    distortion, pupil_shift : array_like, optional
        As of `OPDMaps`: (y, x) of the chief ray beside its field in metres, and of the pupil's
        middle as fractions of its radius, shape (n_wavelengths, n_fields, 2) or (n_fields, 2).
    pupil_distance : float, optional
        As of `OPDMaps`: of the exit pupil from the image plane, in metres.
    max_bytes : int, optional
        Largest allocation of a file; default half of the free memory.

    Returns
    -------
    OPDMaps
        With ``pupil_diameter``, where all listings agree on that of the exit pupil to 1 %.

    Raises
    ------
    FormatError, ValueError
        If a file is no such listing, or the files do not fit together; as `OPDMaps`.

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
    rows = [files] if all(isinstance(one, str | Path) for one in files) else files
    read = [[read_zemax_map(one, max_bytes=max_bytes) for one in row] for row in rows]
    if not read or not read[0] or len({len(row) for row in read}) > 1:
        raise ValueError("Give one file or more for each wavelength, as many for each.")
    every = [one for row in read for one in row]
    shapes = {one.path.shape for one in every}
    if len(shapes) > 1:
        listing = ", ".join(f"{v} x {u}" for v, u in sorted(shapes))
        raise FormatError(
            f"These maps have different samplings, {listing}: save them with the same."
        )
    for row, given in zip(read, rows, strict=True):
        if len({one.wavelength for one in row}) > 1:
            colours = ", ".join(f"{one.wavelength * 1e9:g}" for one in row)
            raise FormatError(
                f"The maps of one wavelength, {', '.join(Path(one).name for one in given)}, are of "
                f"{colours} nm: sort the files by wavelength, then by field."
            )
    return OPDMaps(
        np.array([[one.path for one in row] for row in read]),
        fields=fields,
        wavelengths=[row[0].wavelength for row in read],
        symmetric=symmetric,
        distortion=distortion,
        pupil_shift=pupil_shift,
        pupil_distance=pupil_distance,
        pupil_diameter=_diameter(every),
    )


def _diameter(maps: Sequence[ZemaxMap]) -> float | None:
    """Of the exit pupil, where all maps agree on it to 1 %."""
    found = [one.pupil_diameter for one in maps if one.pupil_diameter]
    agree = len(found) == len(maps) and max(found) <= 1.01 * min(found)
    return float(np.mean(found)) if agree else None
