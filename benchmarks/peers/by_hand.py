"""Refocusing by hand with NumPy, PyTorch, Numba and OpenCV.

Every form takes views (v, u, y, x[, c]) of float32 and one disparity, and returns the mean over the
views where all of them reach, (y, x[, c]) without `margins`: four taps a sample, or along x first.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class ByHand:
    """A form of refocusing.

    Attributes
    ----------
    name : str
    four_taps : bool
        Whether it takes four taps of every sample, or sums along x before y.
    run : callable
        Makes one picture, of the type of its library.
    """

    name: str
    four_taps: bool
    run: Callable[[], Any]


@dataclass(frozen=True)
class Step:
    """How far a view is moved along one axis: a whole number of pixels and a fraction."""

    whole: int
    part: float

    def taps(self) -> tuple[tuple[int, float], tuple[int, float]]:
        """(whole shift, weight) of the two samples that are mixed."""
        return (self.whole, 1 - self.part), (self.whole + 1, self.part)


def steps(views: int, disparity: float) -> list[Step]:
    """Of every view along one axis: ((n - 1)/2 - i) d for i = 0 ... n - 1."""
    shifts = ((views - 1) / 2 - np.arange(views)) * disparity
    return [Step(int(np.floor(s)), float(s - np.floor(s))) for s in shifts]


def margins(shape: tuple[int, ...], disparity: float) -> tuple[int, int, int]:
    """(margin, rows, columns) of the part of the picture that every view reaches.

    Raises
    ------
    ValueError
        If there is none.
    """
    margin = int(np.ceil(abs(disparity) * (max(shape[:2]) - 1) / 2)) + 1
    rows, columns = shape[2] - 2 * margin, shape[3] - 2 * margin
    if min(rows, columns) < 1:
        raise ValueError(
            f"Views of {shape[2]} x {shape[3]} pixels moved by {margin} have no common part: "
            "take a smaller disparity."
        )
    return margin, rows, columns


def numpy_slices(field: Array, disparity: float) -> Array:
    """Four weighted slices a view, added by NumPy."""
    margin, rows, columns = margins(field.shape, disparity)
    total = np.zeros((rows, columns, *field.shape[4:]), np.float32)
    part = np.empty_like(total)
    for v, down in enumerate(steps(field.shape[0], disparity)):
        for u, right in enumerate(steps(field.shape[1], disparity)):
            for y, b in down.taps():
                for x, a in right.taps():
                    top, left = y + margin, x + margin
                    view = field[v, u, top : top + rows, left : left + columns]
                    np.multiply(view, np.float32(a * b), out=part)
                    total += part
    total /= field.shape[0] * field.shape[1]
    return total


def torch_separable(field: Array, disparity: float, *, threads: int) -> Callable[[], Any]:
    """Along x into the sum of a row of views, then along y, by PyTorch."""
    import torch

    views = torch.from_numpy(field)
    margin, rows, columns = margins(field.shape, disparity)
    vertical, horizontal = (steps(n, disparity) for n in field.shape[:2])

    def run() -> Any:
        torch.set_num_threads(threads)
        total = torch.zeros((rows, columns, *field.shape[4:]))
        row = torch.empty((rows + 1, columns, *field.shape[4:]))
        for v, down in enumerate(vertical):
            row.zero_()
            top = down.whole + margin
            for u, right in enumerate(horizontal):
                for x, a in right.taps():
                    left = x + margin
                    row.add_(views[v, u, top : top + rows + 1, left : left + columns], alpha=a)
            total.add_(row[:-1], alpha=1 - down.part).add_(row[1:], alpha=down.part)
        return total.div_(field.shape[0] * field.shape[1])

    return run


def numba_taps(field: Array, disparity: float, *, threads: int) -> Callable[[], Any]:
    """Four taps a sample in a loop over views, rows of the picture in parallel, by Numba."""
    import numba

    margin, rows, columns = margins(field.shape, disparity)
    flat = field.reshape(*field.shape[:3], -1)
    channels = flat.shape[3] // field.shape[3]
    place, weights = _taps(field, disparity)
    loops = _numba_loops()

    def run() -> Any:
        numba.set_num_threads(threads)
        total = np.zeros((rows, columns * channels), np.float32)
        loops(flat, place, weights, total, margin, channels)
        return total.reshape(rows, columns, *field.shape[4:])

    return run


def _numba_loops() -> Any:
    import numba

    @numba.njit(parallel=True, fastmath=True)
    def loops(
        views: Array, place: Array, weights: Array, total: Array, margin: int, channels: int
    ) -> None:
        U, width = views.shape[1], total.shape[1]
        for row in numba.prange(total.shape[0]):
            out = total[row]
            for n in range(place.shape[0]):
                top = row + margin + place[n, 0]
                left = (margin + place[n, 1]) * channels
                upper, lower = views[n // U, n % U, top], views[n // U, n % U, top + 1]
                a, b, c, d = weights[n, 0], weights[n, 1], weights[n, 2], weights[n, 3]
                left_up, right_up = upper[left:], upper[left + channels :]
                left_down, right_down = lower[left:], lower[left + channels :]
                for s in range(width):
                    mixed = a * left_up[s] + b * right_up[s]
                    out[s] += mixed + c * left_down[s] + d * right_down[s]
            for s in range(width):
                out[s] /= np.float32(place.shape[0])

    return loops


def _taps(field: Array, disparity: float) -> tuple[Array, Array]:
    """Whole shifts (V U, 2) and the four weights (V U, 4) of every view."""
    vertical, horizontal = (steps(n, disparity) for n in field.shape[:2])
    place = [(d.whole, r.whole) for d in vertical for r in horizontal]
    weights = [
        [b * a for _, b in d.taps() for _, a in r.taps()] for d in vertical for r in horizontal
    ]
    return np.array(place), np.array(weights, np.float32)


def opencv_warp(field: Array, disparity: float, *, threads: int) -> Callable[[], Any]:
    """One warpAffine a view, added by ``cv2.add``.

    OpenCV may round the fraction of a shift to 1/32 of a pixel.
    """
    import cv2

    margin, rows, columns = margins(field.shape, disparity)
    vertical, horizontal = (steps(n, disparity) for n in field.shape[:2])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP

    def run() -> Any:
        cv2.setNumThreads(threads)
        total = np.zeros((rows, columns, *field.shape[4:]), np.float32)
        part = np.empty_like(total)
        for v, down in enumerate(vertical):
            for u, right in enumerate(horizontal):
                x, y = (step.whole + step.part + margin for step in (right, down))
                move = np.array([[1, 0, x], [0, 1, y]], np.float64)
                cv2.warpAffine(field[v, u], move, (columns, rows), dst=part, flags=flags)
                cv2.add(total, part, dst=total)
        return np.divide(total, field.shape[0] * field.shape[1], out=total)

    return run


_FORMS: tuple[tuple[str, str, bool, Callable[..., Callable[[], Any]]], ...] = (
    ("torch", "torch, separable", False, torch_separable),
    ("numba", "numba, four taps", True, numba_taps),
    ("cv2", "OpenCV, warpAffine a view", True, opencv_warp),
)


def by_hand(field: Array, disparity: float, threads: tuple[int, ...]) -> list[ByHand]:
    """Every form whose library is installed, at each number of threads; NumPy's at one.

    Parameters
    ----------
    field : numpy.ndarray
        float32, shape (V, U, ny, nx) or (V, U, ny, nx, c), C-contiguous.
    disparity : float
        Pixels a view step.
    threads : tuple of int

    Returns
    -------
    list of ByHand
    """
    forms = [ByHand("numpy, four slices a view", True, lambda: numpy_slices(field, disparity))]
    for module, name, four_taps, make in _FORMS:
        if importlib.util.find_spec(module) is None:
            continue
        for count in threads:
            label = f"{name}, {count} thread{'s' if count > 1 else ''}"
            forms.append(ByHand(label, four_taps, make(field, disparity, threads=count)))
    return forms
