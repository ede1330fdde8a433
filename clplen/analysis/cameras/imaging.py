"""Point sources at a camera's lenslets, and pictures with their scale from its raw images."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.point.samples import Pair, Values
from clplen.cameras.camera_base import Plenoptic
from clplen.cameras.optics.camera_aberrations import NONE
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.lightfield.focused.focused_geometry import FocusedGeometry
from clplen.lightfield.focused.focused_picture import FocusedImage
from clplen.lightfield.focused.focused_rendering import render_focused
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.refocusing.focal_stacks import refocus


def is_focused(camera: Any) -> bool:
    """Return True for a focused (2.0) camera."""
    return bool(camera.kind == "focused")


def sample_offsets(step: float, count: int) -> Values:
    """Return ``count`` offsets about 0 that divide a step evenly."""
    return np.asarray((np.arange(count) - (count - 1) / 2) * (step / count), np.float64)


def central_lenslet(camera: Plenoptic) -> tuple[int, int]:
    """Return (row, column) of the lenslet next to the array's middle, in an unshifted row."""
    rows, columns = camera.mla.count
    row = rows // 2
    return row - (row % 2 if camera.mla.lattice == "hexagonal" else 0), columns // 2


def point_at_lenslet(camera: Plenoptic, offset: Pair, dz: float) -> PointSources:
    """Return a point whose chief ray meets the array at an offset from the middle lenslet."""
    turn = camera.mla.rotation
    y, x = offset
    across = (y * np.cos(turn) + x * np.sin(turn), -y * np.sin(turn) + x * np.cos(turn))
    position = np.asarray(camera.mla.centres()[central_lenslet(camera)]) + across
    position = position / camera.array_scale(dz)
    return PointSources([(position[1], position[0], dz)])


def is_symmetric(camera: Plenoptic) -> bool:
    """Return True if the camera has mirror symmetry about its middle lenslet, along y and x."""
    mla = camera.mla
    plain = mla.lattice == "square" and len(mla.focal_lengths) == 1
    centred = mla.rotation == 0 and tuple(mla.offset) == (0, 0) and all(n % 2 for n in mla.count)
    return plain and centred and camera.aberrations == NONE


OVERSAMPLING = 4  # samples of a focused camera's picture per sample that it needs


@dataclass(frozen=True, eq=False, repr=False)
class Rendered:
    """A picture and its scale.

    Attributes
    ----------
    values : numpy.ndarray
        Intensities, float64, shape (ny, nx).
    pitch : tuple of float
        Sample pitch (dy, dx) in metres on the main lens' image of the plane in focus.
    origin : tuple of float
        Position (y, x) of sample (ny//2, nx//2) in metres; along the array's rows for a 1.0 camera.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> point = clplen.PointSources([(0.0, 0.0, 0.0)])
    >>> cameras = clplen.analysis.compare({"a": camera}, only=["pictures"], scenes={"a": point})
    >>> cameras["a"].picture
    <Rendered 7 x 7, pitch 0.0001 x 0.0001 m>
    """

    values: Values
    pitch: Pair
    origin: Pair = (0.0, 0.0)

    def __repr__(self) -> str:
        ny, nx = self.values.shape
        return f"<Rendered {ny} x {nx}, pitch {self.pitch[0]:g} x {self.pitch[1]:g} m>"


def local_m(camera: Any, dz: float) -> float:
    """Return z3/(z2 - F') of a focused camera's lenslets at dz; infinite on the array."""
    alpha = camera.alpha(dz)
    a = camera.array_distance - camera.image_distance / alpha if alpha else -math.inf
    return float(camera.sensor_distance / a) if a else math.inf


def refocused_picture(raw: RawImage, dz: float) -> Values:
    """Refocus a 1.0 camera's picture on dz, one sample per lenslet, float64 (rows, columns).

    The picture is not rescaled, so that samples are at chief rays on the array. Views shift in
    Fourier space, free of interpolation blur.
    """
    camera: Any = raw.camera
    lf = LightField.from_raw(raw)
    picture = refocus(lf, alpha=camera.alpha(dz), interpolation="fourier")
    return np.asarray(picture.to_numpy(), np.float64)


def blended_picture(raw: RawImage, dz: float) -> Rendered:
    """Render the blended picture of a 2.0 camera focused on dz, finely sampled.

    The samples are `OVERSAMPLING` times finer than required by the lenslets' diffraction,
    lam a/(2 d), and by the pixels, dx/abs(m).
    """
    camera: Any = raw.camera
    m = local_m(camera, dz)
    if m == 0:
        raise ValueError(f"dz = {dz:g} m is imaged at infinity; choose another depth.")
    diffraction = camera.wavelength * abs(camera.sensor_distance / m) / (2 * camera.mla.diameter)
    sample_pitch = min(diffraction, camera.pixel_pitch / abs(m)) / OVERSAMPLING
    ratio = float(FocusedGeometry.of(raw).ratio(m))
    step = sample_pitch / abs(camera.pixel_pitch * ratio / m) if ratio else None
    return _on_host(render_focused(raw, m=m, step=step))


def native_picture(raw: RawImage) -> Rendered:
    """Render the picture focused on the camera's own plane, at its native sampling.

    A sample is a lenslet (1.0), or a pixel over abs(m) of the blended picture (2.0).
    """
    camera: Any = raw.camera
    if is_focused(camera):
        return _on_host(render_focused(raw, m=local_m(camera, 0.0)))
    pitch = (camera.mla.row_pitch, camera.mla.pitch)
    return Rendered(refocused_picture(raw, 0.0), pitch, _middle(camera.mla))


def _middle(mla: Any) -> Pair:
    """Return (y, x) of lenslet (rows//2, columns//2) of an unshifted row, along the array."""
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    (down, right), (rows, columns) = mla.offset, mla.count
    y = (rows // 2 - (rows - 1) / 2) * mla.row_pitch + down * cos - right * sin
    x = (columns // 2 - (columns - 1) / 2) * mla.pitch + down * sin + right * cos
    return y, x


def _on_host(image: FocusedImage) -> Rendered:
    y, x = image.positions()
    origin = (float(y[len(y) // 2]), float(x[len(x) // 2]))
    return Rendered(np.asarray(image.to_numpy(), np.float64), (image.pitch, image.pitch), origin)
