"""Views between the recorded ones, sampled along rays in views that see the point.

The disparities of the centre view are warped to the new viewpoint, with nearer points in front;
areas hidden in the centre view get the disparity behind the edge. A pixel p of disparity d is then
L[k](p + (s_k - s) d) in view k, with s and s_k the steps of the new viewpoint and of view k. Views
in which a nearer surface hides the point are ignored.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import float64_array
from clplen.compute.arrays import Image
from clplen.lightfield.arrays.ray_samples import checked_disparity
from clplen.lightfield.arrays.stored_samples import plane
from clplen.lightfield.model.alpha_law import require_overlap, unit_steps
from clplen.lightfield.model.apertures import aperture_weights
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.model.stored_light_field import as_lightfield

Array = np.ndarray[Any, Any]

_MIN_OCCLUSION = 0.5  # pixels: displacement above which a nearer surface hides a point
_OTHER_WEIGHT = 1e-4  # weight of views beyond the four nearest, for points hidden in these
_UNSEEN_WEIGHT = 1e-8  # weight of the nearest views for points that no view sees
_MIN_VISIBLE_WEIGHT = 0.05  # weight of the nearest views below which other views are used
_MAX_OTHERS = 12  # maximum number of other views
_MAX_CACHED = 32  # views cached on the host


def view_between(lf: LightField | ArrayLike, v: float, u: float, disparity: ArrayLike) -> Image:
    """Render the view at (v, u) along the depth of the scene.

    Each pixel is sampled at its disparity in the four recorded views around (v, u) (two or one on a
    grid line), weighted bilinearly in the aperture. Views in which it is hidden are ignored; if it
    is hidden in all of them, up to twelve others are used. Points that no view sees are taken from
    the nearest views. At a recorded view the result is that view.

    Parameters
    ----------
    lf : LightField or array_like
        Light field, or an array (v, u, y, x[, c]).
    v, u : float
        Viewpoint, 0 <= v <= V - 1, 0 <= u <= U - 1.
    disparity : float or array_like
        Disparity of the scene in the centre view, in pixels a view step: a number, or shape (y, x).

    Returns
    -------
    Image
        Picture, float32, shape (y, x[, c]).

    Raises
    ------
    ValueError, ShapeError
        If (v, u) lies outside the views, or a disparity is not finite or of wrong shape.

    See Also
    --------
    LightField.view : Faster, for scenes without depth edges.

    Notes
    -----
    Splatting with a z-buffer, hole filling from behind, and lookup in the views: depth image based
    rendering after Fehn (2004), Proc. SPIE 5291, 93, with visibility as in Buehler et al. (2001),
    Proc. SIGGRAPH, 425. Samples are interpolated by cubic splines.

    Examples
    --------
    >>> ramp = np.arange(60, dtype=np.float32)  # a row of a plane of disparity 1
    >>> rows = np.stack([ramp[4 + u : 52 + u] for u in range(3)])
    >>> lf = np.broadcast_to(rows[:, None], (1, 3, 32, 48))
    >>> picture = clplen.lightfield.view_between(lf, 0, 1.5, 1.0).to_numpy()
    >>> np.round(picture[16, 20:23], 3).tolist()
    [25.5, 26.5, 27.5]
    """
    return next(views_between(lf, [(v, u)], disparity))


def views_between(
    lf: LightField | ArrayLike, viewpoints: Iterable[tuple[float, float]], disparity: ArrayLike
) -> Iterator[Image]:
    """Render `view_between` for many viewpoints, with shared data of recorded views.

    Parameters
    ----------
    lf : LightField or array_like
        Light field, or an array (v, u, y, x[, c]).
    viewpoints : iterable of tuple of float
        Position (v, u) of each view.
    disparity : float or array_like
        Disparity as in `view_between`.

    Returns
    -------
    iterator of Image
        Pictures, float32, shape (y, x[, c]).

    Raises
    ------
    ValueError, ShapeError
        Errors of `view_between`, before the first view.

    Examples
    --------
    >>> lf = np.random.default_rng(0).random((3, 5, 24, 32), np.float32)
    >>> along = [(1, u) for u in np.linspace(0, 4, 9)]
    >>> len(list(clplen.lightfield.views_between(lf, along, 0.0)))
    9
    """
    lf = as_lightfield(lf)
    positions = [(float(v), float(u)) for v, u in map(float64_array, viewpoints)]
    nearest = [aperture_weights(lf, None, at).astype(np.float64) for at in positions]
    return _render_each(_Recorded(lf, disparity), nearest)


def viewpoint_step(lf: SampledViews, v: float, u: float) -> Array:
    """Return the shift (y, x) in pixels from the centre view to (v, u), at disparity 1."""
    nearest = aperture_weights(lf, None, (v, u)).astype(np.float64)
    return np.asarray(np.tensordot(nearest, unit_steps(lf), 2))


def _render_each(recorded: _Recorded, nearest: list[Array]) -> Iterator[Image]:
    for weights in nearest:
        picture = np.ascontiguousarray(recorded.picture_at(weights), np.float32)
        yield Image(recorded.lf.device.upload(picture), recorded.lf.device)


class _View(NamedTuple):
    """A view on the host: cubic splines (c, y, x), and the nearest disparity within a pixel."""

    splines: Array
    front: Array


class _Recorded:
    """Recorded views of a light field and their disparities."""

    def __init__(self, lf: LightField, disparity: ArrayLike) -> None:
        d = checked_disparity(disparity, (lf.shape[2], lf.shape[3]))
        self.lf = lf
        self.disparity = np.broadcast_to(d, lf.shape[2:4])
        self.steps = unit_steps(lf)
        require_overlap(lf, lf.weights, d)
        self._views: OrderedDict[tuple[int, int], _View] = OrderedDict()

    def picture_at(self, nearest: Array) -> Array:
        """Return the picture at a viewpoint by bilinear weights (V, U); float64, (y, x[, c])."""
        if np.count_nonzero(nearest) == 1:  # a recorded view, whatever its weight
            v, u = (int(n) for n in np.argwhere(nearest)[0])
            return self._samples(v, u)
        step = np.tensordot(nearest, self.steps, 2)
        d = carried(self.disparity, step)
        rows, columns = (axis.ravel() for axis in np.indices(d.shape, dtype=np.float64))
        points = np.stack((rows, columns, d.ravel()))
        weights_used = nearest * self.lf.weights
        weights_used = weights_used if weights_used.any() else nearest
        total = np.zeros((self._channels, points.shape[1]))
        sums = np.zeros(points.shape[1])
        for v, u in np.argwhere(weights_used > 0):
            weights, samples = self._look_up(int(v), int(u), step, points)
            weights = weights_used[v, u] * (weights + _UNSEEN_WEIGHT)
            total += weights * samples
            sums += weights
        unseen = np.flatnonzero(sums < _MIN_VISIBLE_WEIGHT * weights_used.sum())
        for v, u in self._others(nearest, step):
            if not unseen.size:
                break
            weights, samples = self._look_up(v, u, step, points[:, unseen])
            weights = _OTHER_WEIGHT * weights
            total[:, unseen] += weights * samples
            sums[unseen] += weights
            unseen = unseen[weights <= 0]
        picture = (total / sums).reshape(-1, *d.shape)
        return np.moveaxis(picture, 0, -1).reshape(self.lf.shape[2:])

    @property
    def _channels(self) -> int:
        return self.lf.shape[4] if len(self.lf.shape) == 5 else 1

    def _others(self, nearest: Array, step: Array) -> list[tuple[int, int]]:
        """Return further views, sorted by their distance from the viewpoint."""
        candidates = np.argwhere((nearest == 0) & (self.lf.weights > 0))
        distances = [np.linalg.norm(self.steps[v, u] - step) for v, u in candidates]
        return [
            (int(v), int(u))
            for v, u in candidates[np.argsort(distances, kind="stable")[:_MAX_OTHERS]]
        ]

    def _look_up(self, v: int, u: int, step: Array, points: Array) -> tuple[Array, Array]:
        """Return weights (n,), 1 where view (v, u) sees a point, else 0, and samples (c, n).

        ``points`` are y, x and disparity at the viewpoint of ``step``.
        """
        from scipy.ndimage import map_coordinates

        view = self._view(v, u)
        move = self.steps[v, u] - step
        y, x = (points[i] + move[i] * points[2] for i in (0, 1))
        ny, nx = view.front.shape
        inside = (y >= -0.5) & (y <= ny - 0.5) & (x >= -0.5) & (x <= nx - 0.5)
        y, x = np.clip(y, 0, ny - 1), np.clip(x, 0, nx - 1)
        front = view.front[np.rint(y).astype(np.intp), np.rint(x).astype(np.intp)]
        hidden = (front - points[2]) * np.linalg.norm(move) > _MIN_OCCLUSION
        samples = [
            map_coordinates(spline, (y, x), order=3, mode="mirror", prefilter=False)
            for spline in view.splines
        ]
        return (inside & ~hidden).astype(np.float64), np.stack(samples)

    def _samples(self, v: int, u: int) -> Array:
        samples = plane(self.lf.data, {0: v, 1: u}, (2, 3), self.lf.device)
        return np.asarray(self.lf.device.download(samples), np.float64)

    def _view(self, v: int, u: int) -> _View:
        from scipy.ndimage import maximum_filter, spline_filter

        if (v, u) in self._views:
            self._views.move_to_end((v, u))
            return self._views[v, u]
        samples = self._samples(v, u)
        planes = np.moveaxis(samples.reshape(*samples.shape[:2], -1), -1, 0)
        splines = [
            spline_filter(channel, order=3, mode="mirror", output=np.float32) for channel in planes
        ]
        front = maximum_filter(carried(self.disparity, self.steps[v, u]), 3, mode="nearest")
        self._views[v, u] = _View(np.stack(splines), front)
        if len(self._views) > _MAX_CACHED:
            self._views.popitem(last=False)
        return self._views[v, u]


def carried(disparity: Array, step: Array) -> Array:
    """Warp a disparity map of the centre view to another viewpoint with sharp edges.

    A point p of the centre view moves to p + step d(p); nearer points hide farther ones. Slits of
    one or two pixels, which open on slanted surfaces, are closed. Areas hidden in the centre view
    get the smaller disparity of the two sides along the step.
    """
    from scipy.ndimage import grey_closing

    if not np.any(step):
        return np.asarray(disparity, np.float64)
    ny, nx = disparity.shape
    d = np.asarray(disparity, np.float64).ravel()
    order = np.argsort(d, kind="stable")  # the nearest points come last and win
    y, x = np.divmod(order, nx)
    y = np.rint(y + step[0] * d[order])
    x = np.rint(x + step[1] * d[order])
    inside = (y >= 0) & (y < ny) & (x >= 0) & (x < nx)
    result = np.full((ny, nx), -np.inf)
    result[y[inside].astype(np.intp), x[inside].astype(np.intp)] = d[order][inside]
    if np.isneginf(result).all():
        return np.full((ny, nx), d.min())
    return _filled(grey_closing(result, 3, mode="nearest"), step)


def _filled(carried: Array, step: Array) -> Array:
    """Fill holes with the smaller of the first disparities on both sides along the step."""
    from scipy.ndimage import distance_transform_edt

    holes = np.isneginf(carried)
    if not holes.any():
        return carried
    positions = np.argwhere(holes)
    direction = np.asarray(step) / np.abs(step).max()
    values = np.full((2, len(positions)), np.inf)
    for side, sign in enumerate((1, -1)):
        remaining = np.arange(len(positions))
        for distance in range(1, max(carried.shape)):
            y, x = np.rint(positions[remaining] + sign * distance * direction).astype(np.intp).T
            inside = (y >= 0) & (y < carried.shape[0]) & (x >= 0) & (x < carried.shape[1])
            remaining, y, x = remaining[inside], y[inside], x[inside]
            candidates = carried[y, x]
            values[side, remaining[np.isfinite(candidates)]] = candidates[np.isfinite(candidates)]
            remaining = remaining[~np.isfinite(candidates)]
            if not remaining.size:
                break
    lower = values.min(0)
    result = carried.copy()
    result[holes] = lower
    missing = np.isposinf(result)
    if missing.any():  # no value on either side along the step
        nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
        result = result[tuple(nearest)]
    return np.asarray(result)
