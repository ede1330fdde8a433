"""Focused plenoptic camera (2.0): every lenslet takes a small picture of the main image.

A lenslet of focal length f images the main lens' image, a before the array (a > 0, Keplerian) or
behind it (a < 0, Galilean, a virtual object), onto the sensor b behind the array, 1/a + 1/b = 1/f,
magnified by m = b/a:  a = f (1 + 1/m), b = f (1 + m)  (Lumsdaine and Georgiev 2009, "The focused
plenoptic camera"). The point X of the main image appears under the lenslet at c at c + m (c - X).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import ClassVar, Literal

from clplen import units
from clplen.cameras.camera_base import Plenoptic, build, main_lens_distances
from clplen.cameras.description import Description, Row, optics_rows
from clplen.cameras.optics.camera_aberrations import NONE, Aberrations
from clplen.cameras.optics.lenslet_camera import Kind
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.checks import fits_float64
from clplen.compute.device import DeviceLike
from clplen.wave.elements.lenslets import MicrolensArray

MIN_PATCH_PIXELS = 0.1  # minimum shift between pictures of neighbouring lenslets, in pixels


@dataclass(frozen=True, repr=False)
class Plenoptic2(Plenoptic):
    """Plenoptic 2.0 camera, built by `PlenopticCamera.type2`.

    Attributes
    ----------
    kind : str
        "focused".
    m : float
        b/a, magnification of the lenslets (of the first kind in a multi-focus array): > 0
        Keplerian, < 0 Galilean.
    image_distance : float
        F in metres, from the main lens to the image of the focused plane, not to the array.
    focal_length, object_distance, aperture_diameter, mla, wavelength, field_lens, device
        Same attributes as in `Plenoptic1`; ``field_lens`` is False.
    pixels_per_lenslet, pixel_pitch, grid, aberrations, lens_model, pixels
        Same attributes as in `Plenoptic1`.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5), m=0.25,
    ...     wavelength=532e-9, pixels_per_lenslet=15)
    >>> f"a = {camera.a * 1e3:.1f} mm, b = {camera.b * 1e3:.1f} mm"
    'a = 50.0 mm, b = 12.5 mm'
    >>> f"{camera.views:.2f} lenslets in a row see a point"
    '4.83 lenslets in a row see a point'
    """

    kind: ClassVar[Kind] = "focused"

    @property
    def patch_size(self) -> float:
        """Pixels of each sub-image that tile the main image without a seam, abs(m) p F/(z2 dx).

        Chief rays through neighbouring lenslets, p apart on the array, are p F/z2 apart there.
        """
        spacing = self.mla.pitch * self.image_distance / self.array_distance
        return abs(self.m) * spacing / self.pixel_pitch

    @property
    def views(self) -> float:
        """Lenslets in a row that see a point in focus, D abs(a)/(F p).

        1/abs(m) if the aperture matches the cone, p F/b; abs(1 + a/F) times that if it matches
        the pupil, p z2/b.
        """
        blur = self.aperture_diameter * abs(self.a) / self.image_distance
        return blur / self.mla.pitch

    def describe(self) -> Description:
        """Return the derived parameters as a `Description`."""
        p, d, lam = self.mla.pitch, self.mla.diameter, self.wavelength
        kind = "Keplerian" if self.m > 0 else "Galilean"
        side = "behind" if self.m > 0 else "before"
        ny, nx = self.grid.shape
        rows = (
            Row("focal length", self.focal_length, "m", "main lens"),
            Row("object distance", self.object_distance, "m", "focused plane to main lens"),
            Row("image distance", self.image_distance, "m", "F, main lens to its image"),
            Row("array distance", self.array_distance, "m", f"z2 = F + a, {side} the image"),
            Row("a", self.a, "m", "image to array"),
            Row("b", self.b, "m", "array to sensor"),
            Row("m", self.m, "", "b/a, magnification of a lenslet"),
            Row("aperture", self.aperture_diameter, "m", "D, main lens"),
            Row("f-number", self.focal_length / self.aperture_diameter, "", "f/D"),
            Row(
                "working f-number",
                self.array_distance / self.aperture_diameter,
                "",
                f"z2/D; a lenslet has b/p = {self.b / p:.6g}",
            ),
            Row("lenslets", self.mla.count[1], "", f"a row, {self.mla.count[0]} rows"),
            Row("lenslet pitch", p, "m", f"{self.pixels_per_lenslet:.6g} pixels"),
            *_focal_rows(self.mla),
            Row("pixel pitch", self.pixel_pitch, "m", f"sensor {ny} x {nx}"),
            Row("pixel on the image", self.pixel_pitch / abs(self.m), "m", "dx/m"),
            Row("patch size", self.patch_size, "", "pixels, abs(m) p F/(z2 dx)"),
            Row("views", self.views, "", "lenslets in a row that see a point, D abs(a)/(F p)"),
            Row("spot width", 0.886 * lam * self.b / d, "m", "on the sensor, 0.886 lam b/d"),
            Row("cut-off", d / (lam * abs(self.a)), "1/m", "of the main image, d/(lam a)"),
            *optics_rows(self.optics),
        )
        return Description(f"Plenoptic 2.0 camera, {kind}", rows)


def _focal_rows(mla: MicrolensArray) -> tuple[Row, ...]:
    """Return rows of the focal length of each kind of lenslet."""
    if len(mla.focal_lengths) == 1:
        return (Row("lenslet focal length", mla.focal_length, "m", "f_mu"),)
    return tuple(
        Row(f"lenslet focal length {n}", f, "m", "f_mu of one kind")
        for n, f in enumerate(mla.focal_lengths)
    )


def type2(
    *,
    focal_length: float,
    mla: MicrolensArray,
    wavelength: float,
    pixels_per_lenslet: float | None = None,
    device: DeviceLike | None = None,
    m: float | None = None,
    a: float | None = None,
    object_distance: float | None = None,
    image_distance: float | None = None,
    aperture_diameter: float | None = None,
    match: Literal["pupil", "cone"] = "pupil",
    aberrations: Aberrations = NONE,
    pixels: PixelArray | None = None,
    lens_model: Literal["auto", "thin", "corrected"] = "auto",
) -> Plenoptic2:
    """Build a focused plenoptic camera: lenslets image the main lens' image onto the sensor.

    1/a + 1/b = 1/f_mu and m = b/a, so that a = f_mu (1 + 1/m) and b = f_mu (1 + m) (Lumsdaine
    and Georgiev 2009). Keplerian, m > 0: the array lies a behind the image at F, b > f_mu.
    Galilean, -1 < m < 0: abs(a) before it, b < f_mu.

    Parameters
    ----------
    focal_length, wavelength, pixels_per_lenslet, device, aberrations, pixels, lens_model
        Same parameters as in `PlenopticCamera.type1`.
    mla : MicrolensArray
        Array of lenslets. m and a refer to the first of several focal lengths; the others are in
        focus at 1/a = 1/f_mu - 1/b.
    m, a : float, optional
        Magnification of the lenslets, or distance from the main lens' image to the array in metres
        (above f_mu or negative). Give exactly one of them.
    object_distance, image_distance : float, optional
        Distances from the main lens to the focused object plane and to its image (not to the
        array), in metres. The lens law gives a missing distance; by default both are 2f.
    aperture_diameter : float, optional
        Diameter of the main lens in metres; by default it follows from ``match``.
    match : {"pupil", "cone"}
        "pupil": D = p z2/b, z2 = F + a, so that the image of the pupil fills a cell. "cone": p F/b.

    Returns
    -------
    Plenoptic2

    Raises
    ------
    ValueError
        If a length is not positive, distances contradict the lens law, m = 0 or m <= -1, a is
        within f_mu, both or none of m and a are given, the array is before the main lens, match
        is another value, or aberrations do not fit.
    TypeError
        If m or a is not a number.
    SamplingError
        If a lenslet has less than 2 pixels.

    Warns
    -----
    SamplingWarning
        If NA = D/(2 F) of the main lens is above 0.4.
    """
    distances = main_lens_distances(
        mla, wavelength, focal_length, object_distance, image_distance, aperture_diameter
    )
    F, m = distances[1], _magnification(mla.focal_length, m, a)
    z2, b = F + mla.focal_length * (1 + 1 / m), mla.focal_length * (1 + m)
    matched = _matched_aperture(match, pitch=mla.pitch, F=F, z2=z2, b=b)
    camera = build(
        Plenoptic2,
        distances=distances,
        aperture_diameter=matched if aperture_diameter is None else aperture_diameter,
        focal_length=focal_length,
        wavelength=wavelength,
        mla=mla,
        pixels_per_lenslet=pixels_per_lenslet,
        pixels=pixels,
        lens_model=lens_model,
        aberrations=aberrations,
        device=device,
        field_lens=False,
        m=float(m),
    )
    if camera.patch_size < MIN_PATCH_PIXELS:
        raise ValueError(
            f"m = {m:.3g} (a = {camera.a:g} m) shifts the picture by only "
            f"{camera.patch_size:.2g} pixels from lenslet to lenslet: use abs(m) >= "
            f"{_min_m(mla.focal_length, F, camera.pixels_per_lenslet):.2g}. Lengths are in "
            "metres."
        )
    return camera


def _magnification(f: float, m: float | None, a: float | None) -> float:
    """Return m of a 2.0 camera from m or a."""
    for name, value in (("m", m), ("a", a)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, Real)):
            raise TypeError(f"{name} must be a real number, got {value!r}.")
    units.LENSLET_FOCAL_LENGTH.check(a or 0.0, "a")
    if (m is None) == (a is None):
        raise ValueError(
            f"Give exactly one of m and a for a 2.0 camera, got m = {m!r} and a = {a!r}."
        )
    if a is not None:
        if not fits_float64(a) or 0 <= a <= f:
            raise ValueError(
                f"a must be > f (Keplerian) or < 0 (Galilean) for lenslets of focal length "
                f"{f:g} m, got {a!r} m."
            )
        return f / (a - f)
    assert m is not None
    if not fits_float64(m) or m == 0:
        raise ValueError(
            f"m = b/a must be > 0 (Keplerian) or -1 < m < 0 (Galilean), and finite, got {m!r}."
        )
    if m <= -1:
        raise ValueError(
            f"m must be > -1, got {m!r}: the sensor would be at b = f (1 + m) = {f * (1 + m):g} m, "
            "before the array."
        )
    return m


def _matched_aperture(match: str, *, pitch: float, F: float, z2: float, b: float) -> float:
    """Return D of the main lens in metres.

    "pupil": p z2/b, the image of the pupil fills a cell. "cone": p F/b, as from the main image.
    """
    if match not in ("pupil", "cone"):
        raise ValueError(f"match must be 'pupil' or 'cone', got {match!r}.")
    if not z2 > 0:
        raise ValueError(
            f"a = {z2 - F:g} m puts the array {-z2:g} m before the main lens, whose image is at "
            f"{F:g} m: use a larger abs(m), or lenslets of a shorter focal length."
        )
    return pitch * (z2 if match == "pupil" else F) / b


def _min_m(f: float, F: float, pixels: float) -> float:
    """Return m of the smallest patch, m pixels F/(F + f + f/m), of a Keplerian camera."""
    linear, square = MIN_PATCH_PIXELS * (F + f), pixels * F
    return (linear + math.sqrt(linear**2 + 4 * square * MIN_PATCH_PIXELS * f)) / (2 * square)
