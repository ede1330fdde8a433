"""Light fields in MATLAB files of versions 5 to 7.2; 7.3 is HDF5 (`clplen.io.lightfields.hdf5_foreign`)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats.mat5 import Samples, Variable, variables
from clplen.io.formats.untrusted import DEFLATE
from clplen.io.lightfields.array_sources import (
    Found,
    Selection,
    Source,
    axes_known,
    light_field,
    reading,
)
from clplen.io.lightfields.hdf5_foreign import LF, has_weights
from clplen.io.lightfields.layout import Array, Layout
from clplen.io.lightfields.view_names import listed
from clplen.lightfield.lightfield import LightField


def read(
    path: PathLike, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read a light field of LFToolbox, or any array of 4 or 5 dimensions.

    Taken is the variable that ``dataset=`` names, else ``LF``, else the only one of 4 or 5
    dimensions. LFToolbox's MATLAB size (t, s, v, u, c), t and s being row and column of the view,
    is our (v, u, y, x, c). 2 or 4 channels of ``LF`` are 1 or 3 and a weight: the weight of a view
    is its mean over the view, of the whole range of its type (of 1 if it is real), and 0 for a view
    that is dark throughout.

    Parameters
    ----------
    path : path-like
    device : Device
    layout : Layout
        ``order`` counts the axes as MATLAB does.
    progress : bool
        Whether to show a bar on standard error.

    Returns
    -------
    LightField, str
        The light field, and what was taken for what, in one sentence.

    Raises
    ------
    FormatError
        If the file is truncated or damaged, has no such variable or several, or its values make no
        light field.
    """
    path = Path(path)
    with reading(path), path.open("rb") as file:
        found = variables(file, path)
        variable = _chosen(found, path, layout.dataset)
        source = _source(variable, Samples(file, variable), path, layout)
        return light_field(Found(source), device=device, layout=layout, progress=progress)


def _chosen(found: list[Variable], path: Path, name: str | None) -> Variable:
    held = listed([f"{item.name} {item.shape} {item.dtype or 'no real array'}" for item in found])
    for item in found:
        if item.name == (name or LF) and item.dtype is not None:
            return item
    if name is not None:
        raise FormatError(f"{path} has no variable {name!r} of real numbers; it holds {held}.")
    fitting = [item for item in found if item.dtype is not None and len(item.shape) in (4, 5)]
    if len(fitting) == 1:
        return fitting[0]
    count = "several variables" if fitting else "no variable"
    raise FormatError(
        f"{path} has {count} of real numbers in 4 or 5 dimensions and none named {LF}; it holds "
        f"{held or 'none'}; name one by dataset=."
    )


def _source(variable: Variable, samples: Samples, path: Path, layout: Layout) -> Source:
    what = f"the variable {variable.name!r}"
    axes, known = axes_known(path, what, variable.shape, order=layout.order)
    assert variable.dtype is not None
    assert variable.packed is not None
    shape = variable.shape[::-1]  # as the samples lie in the file

    def read(block: Selection) -> Array:
        start = [part.start for part in block]
        size = [part.stop - part.start for part in block]
        first = int(np.ravel_multi_index(start, shape))
        return samples.read(first, math.prod(size)).reshape(size)

    return Source(
        path,
        what,
        shape,
        variable.dtype,
        axes[::-1],
        known,
        read,
        stored=variable.length,
        ratio=(DEFLATE if variable.compressed else 1.0)
        * (variable.dtype.itemsize / variable.packed.itemsize),
        weighted=has_weights(variable.name, axes, variable.shape),
    )
