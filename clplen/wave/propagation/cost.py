"""What a propagation costs: operations of its Fourier transforms and samples that it holds."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from clplen.compute.lines import Line
from clplen.wave.propagation.description import Description
from clplen.wave.propagation.request import SELF_PADDED, Request


def flops(made: Description) -> float:
    """Operations of the Fourier transforms of one field, 5 L log2 L each.

    Zero rows of padded windows are not transformed: the lines along x on the input's rows, those
    along y on what that gives, and back along x on the rows that are kept. A transfer function is
    made once for a plan and not counted; VkFFT transforms some of the zero rows, too.
    """
    ny, _ = made.request.grid.shape
    _, mx = made.into.shape_after(made.request.grid.shape)
    across = ny * _transforms(made.into.x) + mx * _transforms(made.into.y)
    return (
        across + mx * _transforms(made.back.y) + made.out_grid.shape[0] * _transforms(made.back.x)
    )


def samples_held(made: Description) -> int:
    """Complex samples that one field needs beside itself: the plan, work space and the result."""
    if made.kind == "nothing":
        return 0
    stored = 0 if made.factor is None else math.prod(made.factor.stored)
    result = int(np.prod(made.out_grid.shape, dtype=np.int64))
    return stored + table_samples(made) + 2 * made.work_samples + result


def least_samples(r: Request) -> int:
    """Complex samples that any way of doing a request holds, known before anything is made."""
    (ny, nx), (my, mx) = r.grid.shape, r.target.shape
    length = nx if nx == 1 or r.method in SELF_PADDED else round(r.pad * nx)
    return max(my * mx, ny * length)


def table_samples(made: Description) -> int:
    """Complex samples of the 1-D tables of all maps; what is repeated counts once."""
    ways = (made.into.y, made.into.x, made.back.y, made.back.x)
    return sum(
        table.size
        for way in ways
        for line in set(way)
        for table in (line.pre, line.kernel, line.post)
        if table is not None
    )


def _transforms(lines: Iterable[Line]) -> float:
    """Operations of the transforms of one line of samples."""
    each = {"none": 0, "forward": 1, "inverse": 1, "convolve": 2}
    return sum(each[line.kind] * 5 * line.length * math.log2(line.length) for line in lines)
