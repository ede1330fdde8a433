"""Conversion of light fields between positions on the main lens and directions."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from clplen.checks import fits_float64
from clplen.compute.arrays import OnDevice
from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.raw.raw_image import is_telecentric

Real = np.ndarray[Any, np.dtype[np.float64]]
Kind = TypeVar("Kind", bound="Resampling")

PARAMETRISATIONS = ("two-plane", "point-angle")
INTERPOLATIONS = ("linear", "cubic")

_MIN_VISIBLE = 1e-6  # of a ray: a smaller share counts as not seen


@dataclass(frozen=True)
class _Axis:
    """Axis of views with its axis of pixels."""

    count: int  # Number of views
    step: float  # Step between the views of the result, metres or radians
    # For each pixel: source view minus result view j, both from the middle
    shift: Real
    widens: bool  # True if the result needs more views to keep every ray, False if fewer

    def views(self, count: int | None) -> int:
        """Return the number of views of the result; default keeps every ray and the parity."""
        if count is not None:
            if not count >= 1:
                raise ValueError(f"views must be at least 1 along each axis, got {count!r}.")
            return int(count)
        extra = 2 * math.ceil(np.abs(self.shift).max() - 1e-9)
        return self.count + extra if self.widens else max(1, self.count - extra)

    def sources(self, count: int) -> tuple[Any, Real]:
        """Return (integer source view for view 0, fraction) of each pixel."""
        source = self.shift + (self.count - count) / 2
        integers = np.floor(source)
        return integers.astype(np.int32), source - integers

    def matrix(self, count: int) -> Real:
        """Return shares of the source's views in the result's, averaged over the pixels."""
        matrix = np.zeros((count, self.count))
        integers, fractions = self.sources(count)
        for first, share in zip((integers, integers + 1), (1 - fractions, fractions), strict=True):
            for start, weight in zip(first, share, strict=True):
                j = np.arange(max(0, -start), min(count, self.count - start))
                matrix[j, j + start] += weight / fractions.size
        return matrix


def _axes(lf: Any, parametrisation: str, distance: float) -> tuple[_Axis, _Axis]:
    """Return the axes along v and y, and along u and x."""
    if lf.spacing is None or not np.isfinite(lf.spacing).all():
        raise ValueError(
            "Resampling needs the spacing of views and pixels in metres; pass "
            "spacing=(dv, du, dy, dx)."
        )
    if lf.positions is not None or lf.decode == "naive":
        kind = "views with positions" if lf.positions is not None else "naive cells"
        raise ValueError(
            f"A light field of {kind} has no even steps on the main lens to resample; use a light "
            "field on a regular grid, decoded 'calibrated'."
        )
    from_angles = lf.parametrisation == "point-angle"
    to_angles = parametrisation == "point-angle"
    axes = []
    for axis in (0, 1):
        # On the main lens
        count, step, pitch = lf.shape[axis], lf.spacing[axis], lf.spacing[2 + axis]
        length = -distance * step if from_angles else step  # on the main lens
        pixels = lf.shape[2 + axis]
        x = (np.arange(pixels) - (pixels - 1) / 2) * (0 if is_telecentric(lf) else pitch)
        shifts = np.asarray((to_angles - from_angles) * x / length, np.float64)
        axes.append(_Axis(count, -length / distance if to_angles else length, shifts, to_angles))
    return axes[0], axes[1]


def _image_distance(lf: Any, image_distance: float | None) -> float:
    """Return F in metres."""
    if image_distance is None and lf.camera is not None:
        image_distance = float(lf.camera.image_distance)
    if image_distance is None or not (fits_float64(image_distance) and image_distance > 0):
        raise ValueError(
            "Resampling needs F > 0, the distance from the main lens to the image plane; pass a "
            f"camera or image_distance= in metres, got {image_distance!r}."
        )
    return image_distance


def _launch(lf: Any, axes: tuple[_Axis, _Axis], counts: tuple[int, ...], interpolation: str) -> Any:
    device = lf.device
    shape = (*counts, *lf.shape[2:])
    nbytes = 4 * math.prod(shape)
    device.require_memory(
        nbytes + lf.data.nbytes, f"A light field of {counts[0]} x {counts[1]} views"
    )
    out = device.empty(shape, np.float32)
    tables: list[Any] = []
    for axis, count in zip(axes, counts, strict=True):
        integers, fractions = axis.sources(count)
        linear = np.stack((0 * fractions, 1 - fractions, fractions, 0 * fractions), axis=-1)
        taps = _keys(fractions) if interpolation == "cubic" else linear
        tables += [integers - 1, taps.astype(np.float32), linear.astype(np.float32)]
    defines: dict[str, Any] = {"CUBIC": True} if interpolation == "cubic" else {}
    ny, nx = lf.shape[2:4]
    channels = math.prod(lf.shape[4:])
    device.launch_rows(
        device.kernel("parametrise.cl", "parametrise", SAMPLE=C_TYPE[lf.dtype], **defines),
        (math.prod(counts), ny, nx * channels),
        out,
        lf.data,
        *(device.upload(table) for table in ((lf.weights > 0).astype(np.int32), *tables)),
        *(np.int32(n) for n in (*lf.shape[:2], counts[1], ny, nx, channels)),
    )
    return out


def _keys(part: Real) -> Real:
    """Return taps at -1, 0, 1, 2 of cubic convolution (Keys 1981, eq. 15, a = -1/2)."""
    t = part
    return np.stack(
        (
            ((-0.5 * t + 1) * t - 0.5) * t,
            (1.5 * t - 2.5) * t * t + 1,
            ((-1.5 * t + 2) * t + 0.5) * t,
            (0.5 * t - 0.5) * t * t,
        ),
        axis=-1,
    )


def _weights(lf: Any, axes: tuple[_Axis, _Axis], counts: tuple[int, ...]) -> Any:
    """Return the mean weight of the visible rays of each view, 0 without any."""
    down, right = (axis.matrix(count) for axis, count in zip(axes, counts, strict=True))
    visible = down @ (lf.weights > 0) @ right.T
    total = down @ lf.weights.astype(np.float64) @ right.T
    mean = np.divide(
        total, visible, out=np.zeros_like(visible), where=visible > _MIN_VISIBLE / lf.shape[3]
    )
    return mean.astype(np.float32)


class Resampling(OnDevice):
    """Mix-in for light fields: conversion between main-lens positions and directions."""

    def resample(
        self: Kind,
        parametrisation: str,
        *,
        image_distance: float | None = None,
        views: tuple[int, int] | None = None,
        interpolation: str = "linear",
    ) -> Kind:
        """Resample the rays to positions on the main lens or to directions.

        A ray through u on the main lens and x on the image plane has theta = (x - u)/F, likewise
        along y (paraxial; thesis, sections 1.2 and 1.4.2), both measured from the axis in the
        middle of views and pixels. A point of alpha = F/F' is a line of slope dx/du = 1 - alpha in
        (x, u), and dx/dtheta = F - F' in (x, theta). Steps of theta are -du/F. Views of a
        telecentric camera are directions, theta = -u/F.

        Parameters
        ----------
        parametrisation : {"two-plane", "point-angle"}
            Parametrisation of the result.
        image_distance : float, optional
            Distance F in metres from the main lens to the image plane; default that of ``camera``.
        views : tuple of int, optional
            Number (V, U) of views of the result, centred. By default as many directions as keep
            every ray, or as many positions as before the conversion.
        interpolation : {"linear", "cubic"}
            Interpolation along the view axes (cubic: Keys 1981, a = -1/2, linear at the edges).
            Views outside or of weight 0 are excluded from sum and weight; rays that no view saw are
            0.

        Returns
        -------
        LightField
            Light field of float32; ``weights`` are means over each view's visible rays.

        Raises
        ------
        ValueError
            If the spacing or F is unknown, the views have ``positions`` or are naive cells, or an
            option is out of range.
        DeviceError
            If the result exceeds the device's memory.
        """
        lf: Any = self
        if parametrisation not in PARAMETRISATIONS:
            raise ValueError(
                f"parametrisation must be {' or '.join(map(repr, PARAMETRISATIONS))}, got "
                f"{parametrisation!r}."
            )
        if interpolation not in INTERPOLATIONS:
            raise ValueError(f"interpolation must be 'linear' or 'cubic', got {interpolation!r}.")
        if parametrisation == lf.parametrisation and views is None:
            return self
        axes = _axes(lf, parametrisation, _image_distance(lf, image_distance))
        requested = (None, None) if views is None else views
        counts = tuple(axis.views(n) for axis, n in zip(axes, requested, strict=True))
        resampled: Kind = replace(
            lf,
            data=_launch(lf, axes, counts, interpolation),
            spacing=(axes[0].step, axes[1].step, *lf.spacing[2:]),
            weights=_weights(lf, axes, counts),
            parametrisation=parametrisation,
        )
        return resampled
