"""What a plenoptic camera's pictures hold of objects out of its focused plane: contrast over depth.

For each depth the picture is focused there from its raw image: refocused (1.0) or blended with the
m of that depth (2.0). Frequencies are those on the object, where cameras with other main lenses
compare too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.cameras.imaging import blended_picture, is_focused, refocused_picture
from clplen.analysis.point.otf import Curve
from clplen.analysis.point.samples import Values
from clplen.lightfield.raw.raw_image import RawImage
from clplen.reprs import OneLine


@dataclass(frozen=True, eq=False, repr=False)
class DepthTransfer(OneLine):
    """Contrast of a camera's refocused pictures over depth.

    Attributes
    ----------
    dz : numpy.ndarray
        Metres from the focused plane, farther positive, float64, shape (n,).
    curves : tuple of Curve or None
        Along x, in cycles a metre of the object; None where no picture can be made.
    notes : tuple of str
        Why not; empty where there is one.
    """

    dz: Values
    curves: tuple[Curve | None, ...]
    notes: tuple[str, ...]

    def at(self, contrast: float) -> Values:
        """Frequency at which each curve falls to a contrast, as `Curve.at`; NaN without a curve."""
        found = [np.nan if curve is None else curve.at(contrast) for curve in self.curves]
        return np.array(found, np.float64)

    @property
    def mtf50(self) -> Values:
        """``at(0.5)``."""
        return self.at(0.5)

    @property
    def best(self) -> tuple[float, float]:
        """dz of the highest MTF50, and that; NaN where there is none."""
        found = self.mtf50
        if np.isnan(found).all():
            return float("nan"), float("nan")
        k = int(np.nanargmax(found))
        return float(self.dz[k]), float(found[k])

    @property
    def best_at_end(self) -> bool:
        """Whether that dz is the first or last of all, so that the true one may lie beyond."""
        return self.best[0] in (self.dz.min(), self.dz.max())


def line_curve(line: Values, pitch: float) -> Curve:
    """Modulus of the transfer function of a line's image (Bracewell 1956).

    Parameters
    ----------
    line : numpy.ndarray
        Intensities, shape (n,).
    pitch : float
        Of its samples in metres.

    Returns
    -------
    Curve
        Up to half a cycle a sample, two frequencies for one of the window's.
    """
    length = 2 * len(line)
    spectrum = np.abs(np.fft.rfft(line, length))
    frequency = np.asarray(np.fft.rfftfreq(length, pitch), np.float64)
    return Curve(frequency, np.asarray(spectrum / spectrum[0], np.float64))


def transfer_of(raws: Sequence[RawImage], dz: float) -> Curve:
    """Contrast along x of the pictures of one point, focused on its depth.

    Parameters
    ----------
    raws : sequence of RawImage
        Of one camera; the point moved along x in equal steps which together are a lenslet's pitch
        (`clplen.analysis.cameras.imaging.sample_offsets`).
    dz : float
        Of the point, in metres.

    Returns
    -------
    Curve
        In cycles a metre of the object. 1.0: of the image of a line that the samples of all
        pictures make up together. 2.0: the mean over the pictures.

    Raises
    ------
    ValueError
        If m of a focused camera is 1 or more at this depth.
    """
    camera: Any = raws[0].camera
    if is_focused(camera):
        return _mean([_focused_line(raw, dz) for raw in raws])
    lines = [refocused_picture(raw, dz).sum(axis=0) for raw in raws]
    fine = np.stack(lines[::-1], axis=1).ravel()
    return line_curve(fine, camera.mla.pitch / len(raws) / abs(camera.array_scale(dz)))


def _focused_line(raw: RawImage, dz: float) -> Curve:
    camera: Any = raw.camera
    picture = blended_picture(raw, dz)
    magnified = abs(camera.image_distance / camera.alpha(dz) / (camera.object_distance + dz))
    return line_curve(picture.values.sum(axis=0), picture.pitch[1] / magnified)


def _mean(curves: list[Curve]) -> Curve:
    values = np.mean([curve.value for curve in curves], axis=0)
    return Curve(curves[0].frequency, np.asarray(values, np.float64))


def object_nyquist(camera: Any, dz: float) -> float:
    """Half the samples a metre of the object at dz that the camera's picture has.

    A lenslet's pitch each (1.0), or a pixel over abs(m) of that depth (2.0).
    """
    if is_focused(camera):
        off = abs(camera.array_alpha(dz) - 1)  # m F' = z3/(z2/F' - 1)
        from_object = camera.object_distance + dz
        seen = 2 * camera.pixel_pitch * from_object * off / camera.sensor_distance
        return float(1 / seen) if seen else math.inf
    return float(abs(camera.array_scale(dz)) / (2 * camera.mla.pitch))
