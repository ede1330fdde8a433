"""Light fields by position on the main lens, or by direction: (x, u) or (x, theta)."""

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

_COVERED = 1e-6  # of a ray: what is less was not seen


@dataclass(frozen=True)
class _Axis:
    """One axis of views with its axis of pixels."""

    count: int  # Views
    step: float  # Between the views of the result, metres or radians
    # Of each pixel: the view of the source that its view j is, less j, both from the middle
    shift: Real
    widens: bool  # Whether the views of the result must be more to hold every ray, else fewer

    def views(self, given: int | None) -> int:
        """How many the result has; by default as many as keep every ray, of the same parity."""
        if given is not None:
            if not given >= 1:
                raise ValueError(f"views counts at least one view along each axis, not {given!r}.")
            return int(given)
        more = 2 * math.ceil(np.abs(self.shift).max() - 1e-9)
        return self.count + more if self.widens else max(1, self.count - more)

    def sources(self, count: int) -> tuple[Any, Real]:
        """(whole view of the source for view 0, fraction) of each pixel."""
        at = self.shift + (self.count - count) / 2
        whole = np.floor(at)
        return whole.astype(np.int32), at - whole

    def matrix(self, count: int) -> Real:
        """Share of the source's views in each view of the result, meaned over the pixels."""
        matrix = np.zeros((count, self.count))
        whole, part = self.sources(count)
        for first, share in zip((whole, whole + 1), (1 - part, part), strict=True):
            for start, weight in zip(first, share, strict=True):
                j = np.arange(max(0, -start), min(count, self.count - start))
                matrix[j, j + start] += weight / part.size
        return matrix


def _axes(lf: Any, parametrisation: str, distance: float) -> tuple[_Axis, _Axis]:
    """Along v and y, and along u and x."""
    if lf.spacing is None or not np.isfinite(lf.spacing).all():
        raise ValueError(
            "Another parametrisation needs the spacing of views and pixels in metres: give "
            "spacing=(dv, du, dy, dx)."
        )
    if lf.positions is not None or lf.decode == "naive":
        found = "views with positions of their own" if lf.positions is not None else "naive cells"
        raise ValueError(
            f"A light field of {found} has no even steps on the main lens to resample: use one of "
            "a regular grid, decoded 'calibrated'."
        )
    back = lf.parametrisation == "point-angle"
    to_angles = parametrisation == "point-angle"
    made = []
    for axis in (0, 1):
        count, step, pitch = lf.shape[axis], lf.spacing[axis], lf.spacing[2 + axis]
        length = -distance * step if back else step  # on the main lens
        pixels = lf.shape[2 + axis]
        x = (np.arange(pixels) - (pixels - 1) / 2) * (0 if is_telecentric(lf) else pitch)
        moved = np.asarray((to_angles - back) * x / length, np.float64)
        made.append(_Axis(count, -length / distance if to_angles else length, moved, to_angles))
    return made[0], made[1]


def _image_distance(lf: Any, image_distance: float | None) -> float:
    """F, in metres."""
    if image_distance is None and lf.camera is not None:
        image_distance = float(lf.camera.image_distance)
    if image_distance is None or not (fits_float64(image_distance) and image_distance > 0):
        raise ValueError(
            "Another parametrisation needs F > 0, the distance from the main lens to the image "
            f"plane, by the camera or image_distance= in metres; it is {image_distance!r}."
        )
    return image_distance


def _launch(
    lf: Any, axes: tuple[_Axis, _Axis], counts: tuple[int, ...], interpolation: str
) -> Any:
    device = lf.device
    shape = (*counts, *lf.shape[2:])
    nbytes = 4 * math.prod(shape)
    device.require_memory(
        nbytes + lf.data.nbytes, f"A light field of {counts[0]} x {counts[1]} views"
    )
    out = device.empty(shape, np.float32)
    tables: list[Any] = []
    for axis, count in zip(axes, counts, strict=True):
        whole, part = axis.sources(count)
        linear = np.stack((0 * part, 1 - part, part, 0 * part), axis=-1)
        taps = _keys(part) if interpolation == "cubic" else linear
        tables += [whole - 1, taps.astype(np.float32), linear.astype(np.float32)]
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
    """Taps -1, 0, 1, 2 of cubic convolution (Keys 1981, eq. 15, a = -1/2)."""
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
    """Mean weight of the rays of each view that were seen; 0 where none was."""
    down, right = (axis.matrix(count) for axis, count in zip(axes, counts, strict=True))
    seen = down @ (lf.weights > 0) @ right.T
    total = down @ lf.weights.astype(np.float64) @ right.T
    found = np.divide(total, seen, out=np.zeros_like(seen), where=seen > _COVERED / lf.shape[3])
    return found.astype(np.float32)


class Resampling(OnDevice):
    """The method of a light field that exchanges positions on the main lens and directions."""

    def resample(
        self: Kind,
        parametrisation: str,
        *,
        image_distance: float | None = None,
        views: tuple[int, int] | None = None,
        interpolation: str = "linear",
    ) -> Kind:
        """The same rays by position on the main lens, or by direction.

        A ray through u on the main lens and x on the image plane has theta = (x - u)/F, along y
        alike (paraxial; thesis, sections 1.2 and 1.4.2), both from the axis, which lies in the
        middle of the views and of the pixels. A point of alpha = F/F' is a line of slope
        dx/du = 1 - alpha in (x, u), and dx/dtheta = F - F' in (x, theta). Steps of theta are -du/F.
        Views of a telecentric camera are directions already, theta = -u/F.

        Parameters
        ----------
        parametrisation : {"two-plane", "point-angle"}
        image_distance : float, optional
            F, metres from the main lens to the image plane; by default that of ``camera``.
        views : tuple of int, optional
            (V, U) of the result, about the middle. By default as many directions as hold every
            ray, and back as many positions as there were before.
        interpolation : {"linear", "cubic"}
            Along the view axes (cubic: Keys 1981, a = -1/2, linear next to the edges). Views
            outside or of weight 0 count neither in the sum nor in its weight, and a ray that none
            of them saw is 0.

        Returns
        -------
        LightField
            float32; ``weights`` are the means of the weights of each view's rays that were seen.

        Raises
        ------
        ValueError
            If the spacing or F is not known, the views have ``positions`` or are naive cells, or
            an option is out of range.
        DeviceError
            If the result is larger than the device's memory.
        """
        lf: Any = self
        if parametrisation not in PARAMETRISATIONS:
            raise ValueError(
                f"parametrisation is {' or '.join(map(repr, PARAMETRISATIONS))}, not "
                f"{parametrisation!r}."
            )
        if interpolation not in INTERPOLATIONS:
            raise ValueError(f"interpolation is 'linear' or 'cubic', not {interpolation!r}.")
        if parametrisation == lf.parametrisation and views is None:
            return self
        axes = _axes(lf, parametrisation, _image_distance(lf, image_distance))
        given = (None, None) if views is None else views
        counts = tuple(axis.views(n) for axis, n in zip(axes, given, strict=True))
        resampled: Kind = replace(
            lf,
            data=_launch(lf, axes, counts, interpolation),
            spacing=(axes[0].step, axes[1].step, *lf.spacing[2:]),
            weights=_weights(lf, axes, counts),
            parametrisation=parametrisation,
        )
        return resampled
