"""Views between the recorded ones: points are looked up along their rays, in views that see them.

The disparities of the centre view are carried to the new viewpoint, nearer points before farther
ones, and what the centre view does not see takes the disparity behind the edge. A pixel p of
disparity d is then L[k](p + (s_k - s) d) in view k, s and s_k being the steps of the new viewpoint
and of view k. Views in which something nearer stands at that place do not count.
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

_HIDDEN = 0.5  # pixels by which a surface in front is displaced, beyond which it hides a point
_SPARE = 1e-4  # weight of views beside the four nearest, for points that these do not see
_BLIND = 1e-8  # weight of the nearest views for points that none sees
_UNSEEN = 0.05  # weight of the nearest views that see a point, below which others are asked
_MOST_SPARE = 12  # of these other views
_KEPT = 32  # views on the host at a time


def view_between(lf: LightField | ArrayLike, v: float, u: float, disparity: ArrayLike) -> Image:
    """Return the view at (v, u), rendered along the depth of the scene.

    Each pixel is looked up in the four recorded views round (v, u), or the two or the one among
    which it lies, at its own disparity, and weighted bilinearly in the aperture. Views in which it
    is hidden do not count; where it is hidden in all of these, up to twelve others are asked.
    What no view sees is taken from the nearest ones. At a recorded view the result is that view.

    Parameters
    ----------
    lf : LightField or array_like
        Or an array (v, u, y, x[, c]).
    v, u : float
        0 <= v <= V - 1, 0 <= u <= U - 1.
    disparity : float or array_like
        Of the scene in the centre view, pixels a view step: one number, or shape (y, x).

    Returns
    -------
    Image
        float32, shape (y, x[, c]).

    Raises
    ------
    ValueError, ShapeError
        If (v, u) lies outside the views, a disparity is not finite, or they have another shape.

    See Also
    --------
    LightField.view : Faster, for scenes without edges of depth.

    Notes
    -----
    Splatting with a z-buffer, holes filled from behind, then looking up in the views: depth image
    based rendering after Fehn (2004), Proc. SPIE 5291, 93, with visibility as in Buehler et al.
    (2001), Proc. SIGGRAPH, 425. Samples are cubic splines.

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
    """Return `view_between` of many viewpoints, which share what recorded views need.

    Parameters
    ----------
    lf : LightField or array_like
        Or an array (v, u, y, x[, c]).
    viewpoints : iterable of tuple of float
        (v, u) of each view.
    disparity : float or array_like
        As in `view_between`.

    Returns
    -------
    iterator of Image
        float32, shape (y, x[, c]).

    Raises
    ------
    ValueError, ShapeError
        As in `view_between`, before the first view.

    Examples
    --------
    >>> lf = np.random.default_rng(0).random((3, 5, 24, 32), np.float32)
    >>> along = [(1, u) for u in np.linspace(0, 4, 9)]
    >>> len(list(clplen.lightfield.views_between(lf, along, 0.0)))
    9
    """
    lf = as_lightfield(lf)
    wanted = [(float(v), float(u)) for v, u in map(float64_array, viewpoints)]
    nearest = [aperture_weights(lf, None, at).astype(np.float64) for at in wanted]
    return _rendered(_Recorded(lf, disparity), nearest)


def viewpoint_step(lf: SampledViews, v: float, u: float) -> Array:
    """Return the shift (y, x) in pixels from the centre view to (v, u), at disparity 1."""
    nearest = aperture_weights(lf, None, (v, u)).astype(np.float64)
    return np.asarray(np.tensordot(nearest, unit_steps(lf), 2))


def _rendered(recorded: _Recorded, nearest: list[Array]) -> Iterator[Image]:
    for weights in nearest:
        picture = np.ascontiguousarray(recorded.seen_from(weights), np.float32)
        yield Image(recorded.lf.device.upload(picture), recorded.lf.device)


class _View(NamedTuple):
    """A recorded view on the host: cubic splines (c, y, x), and the disparity of what is nearest
    within a pixel of each pixel."""

    splines: Array
    front: Array


class _Recorded:
    """The recorded views of a light field and the disparities that they see."""

    def __init__(self, lf: LightField, disparity: ArrayLike) -> None:
        d = checked_disparity(disparity, (lf.shape[2], lf.shape[3]))
        self.lf = lf
        self.disparity = np.broadcast_to(d, lf.shape[2:4])
        self.steps = unit_steps(lf)
        require_overlap(lf, lf.weights, d)
        self._views: OrderedDict[tuple[int, int], _View] = OrderedDict()

    def seen_from(self, nearest: Array) -> Array:
        """The picture at a viewpoint of these bilinear weights (V, U); float64, (y, x[, c])."""
        if np.count_nonzero(nearest) == 1:  # a recorded view, whatever its weight
            v, u = (int(n) for n in np.argwhere(nearest)[0])
            return self._samples(v, u)
        step = np.tensordot(nearest, self.steps, 2)
        d = carried(self.disparity, step)
        rows, columns = (axis.ravel() for axis in np.indices(d.shape, dtype=np.float64))
        points = np.stack((rows, columns, d.ravel()))
        used = nearest * self.lf.weights
        used = used if used.any() else nearest
        total = np.zeros((self._channels, points.shape[1]))
        sums = np.zeros(points.shape[1])
        for v, u in np.argwhere(used > 0):
            weights, samples = self._look_up(int(v), int(u), step, points)
            weights = used[v, u] * (weights + _BLIND)
            total += weights * samples
            sums += weights
        unseen = np.flatnonzero(sums < _UNSEEN * used.sum())
        for v, u in self._others(nearest, step):
            if not unseen.size:
                break
            weights, samples = self._look_up(v, u, step, points[:, unseen])
            weights = _SPARE * weights
            total[:, unseen] += weights * samples
            sums[unseen] += weights
            unseen = unseen[weights <= 0]
        picture = (total / sums).reshape(-1, *d.shape)
        return np.moveaxis(picture, 0, -1).reshape(self.lf.shape[2:])

    @property
    def _channels(self) -> int:
        return self.lf.shape[4] if len(self.lf.shape) == 5 else 1

    def _others(self, nearest: Array, step: Array) -> list[tuple[int, int]]:
        """Views that are not among the nearest, by their distance from the viewpoint."""
        free = np.argwhere((nearest == 0) & (self.lf.weights > 0))
        away = [np.linalg.norm(self.steps[v, u] - step) for v, u in free]
        return [(int(v), int(u)) for v, u in free[np.argsort(away, kind="stable")[:_MOST_SPARE]]]

    def _look_up(self, v: int, u: int, step: Array, points: Array) -> tuple[Array, Array]:
        """Weights (n,), 1 where view (v, u) sees a point and 0 elsewhere, and samples (c, n).

        ``points`` are y, x and disparity at the viewpoint whose step is ``step``.
        """
        from scipy.ndimage import map_coordinates

        view = self._view(v, u)
        move = self.steps[v, u] - step
        y, x = (points[i] + move[i] * points[2] for i in (0, 1))
        ny, nx = view.front.shape
        inside = (y >= -0.5) & (y <= ny - 0.5) & (x >= -0.5) & (x <= nx - 0.5)
        y, x = np.clip(y, 0, ny - 1), np.clip(x, 0, nx - 1)
        front = view.front[np.rint(y).astype(np.intp), np.rint(x).astype(np.intp)]
        hidden = (front - points[2]) * np.linalg.norm(move) > _HIDDEN
        samples = [
            map_coordinates(one, (y, x), order=3, mode="mirror", prefilter=False)
            for one in view.splines
        ]
        return (inside & ~hidden).astype(np.float64), np.stack(samples)

    def _samples(self, v: int, u: int) -> Array:
        found = plane(self.lf.data, {0: v, 1: u}, (2, 3), self.lf.device)
        return np.asarray(self.lf.device.download(found), np.float64)

    def _view(self, v: int, u: int) -> _View:
        from scipy.ndimage import maximum_filter, spline_filter

        if (v, u) in self._views:
            self._views.move_to_end((v, u))
            return self._views[v, u]
        samples = self._samples(v, u)
        planes = np.moveaxis(samples.reshape(*samples.shape[:2], -1), -1, 0)
        splines = [spline_filter(one, order=3, mode="mirror", output=np.float32) for one in planes]
        front = maximum_filter(carried(self.disparity, self.steps[v, u]), 3, mode="nearest")
        self._views[v, u] = _View(np.stack(splines), front)
        if len(self._views) > _KEPT:
            self._views.popitem(last=False)
        return self._views[v, u]


def carried(disparity: Array, step: Array) -> Array:
    """A disparity map of the centre view as another viewpoint sees it, edges kept sharp.

    What lies at p in the centre view is at p + step d(p) in the other; nearer points hide farther
    ones. Slits of one or two pixels, which open where a slanted surface grows wider, are closed;
    what the centre view does not see takes the smaller disparity of the two sides along the step.
    """
    from scipy.ndimage import grey_closing

    if not np.any(step):
        return np.asarray(disparity, np.float64)
    ny, nx = disparity.shape
    d = np.asarray(disparity, np.float64).ravel()
    order = np.argsort(d, kind="stable")  # the nearest come last and stay
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
    """The smaller of the disparities that are met first on both sides of a hole."""
    from scipy.ndimage import distance_transform_edt

    holes = np.isneginf(carried)
    if not holes.any():
        return carried
    places = np.argwhere(holes)
    ahead = np.asarray(step) / np.abs(step).max()
    found = np.full((2, len(places)), np.inf)
    for side, sign in enumerate((1, -1)):
        left = np.arange(len(places))
        for distance in range(1, max(carried.shape)):
            y, x = np.rint(places[left] + sign * distance * ahead).astype(np.intp).T
            inside = (y >= 0) & (y < carried.shape[0]) & (x >= 0) & (x < carried.shape[1])
            left, y, x = left[inside], y[inside], x[inside]
            here = carried[y, x]
            found[side, left[np.isfinite(here)]] = here[np.isfinite(here)]
            left = left[~np.isfinite(here)]
            if not left.size:
                break
    lower = found.min(0)
    result = carried.copy()
    result[holes] = lower
    lost = np.isposinf(result)
    if lost.any():  # nothing on either side along the step
        nearest = distance_transform_edt(lost, return_distances=False, return_indices=True)
        result = result[tuple(nearest)]
    return np.asarray(result)
