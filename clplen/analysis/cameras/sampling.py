"""Spatial and angular sampling of plenoptic cameras.

The standard camera (1.0) has one spatial sample per lenslet and one direction per pixel under it
(Ng, Levoy, Bredif, Duval, Horowitz and Hanrahan 2005). The lenslets of the focused camera (2.0)
relay the main lens' image at distance a to the sensor at distance b (Lumsdaine and Georgiev 2009,
Georgiev and Lumsdaine 2010). With m = b/a it keeps abs(m) of the sensor's resolution, and 1/abs(m)
views of every point if main lens and lenslets have equal f-numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from clplen.cameras.optics.lenslet_camera import independent_views
from clplen.checks import check_positive, fits_float64, require
from clplen.reprs import OneLine, columns


@dataclass(frozen=True, repr=False)
class Sampling(OneLine):
    """Sampling along one axis, on the plane of the main lens' image, in metres.

    Attributes
    ----------
    kind : str
        Type of the camera, "1.0" or "2.0".
    spatial_samples : float
        Number of spatial samples: lenslets (1.0), pixels times abs(m) (2.0).
    spatial_share : float
        Ratio of spatial samples to pixels of the sensor.
    spatial_pitch : float
        Distance between spatial samples: the lenslets' pitch (1.0), a pixel over abs(m) (2.0).
    views : float
        Number of directions per spatial sample: pixels per lenslet (1.0); lenslets in the cone of
        light, D abs(a)/(F p), equal to 1/abs(m) for a main lens of the lenslets' f-number b/p
        (2.0).
    angular_step : float
        Angle between directions in radians: pixel/f_mu (1.0), p/abs(a) (2.0).
    angular_range : float
        Range of directions in radians: d/f_mu of a lenslet (1.0), D/F of the main lens (2.0).
    independent_views : float
        Number of directions that the lenslet's diffraction resolves: d^2/(lam f_mu), at most the
        pixels per lenslet (1.0); the views themselves, from different lenslets (2.0).
    nyquist : float
        Highest spatial frequency of the samples, 1/(2 spatial_pitch), cycles a metre.
    diffraction_cutoff : float
        Highest spatial frequency of the light in cycles a metre: D/(lam F) of the main lens (1.0),
        d/(lam abs(a)) of the lenslet (2.0).

    Examples
    --------
    >>> sampling = clplen.analysis.type1_sampling(
    ...     lenslets=100, pitch=100e-6, diameter=100e-6, focal_length=2e-3, pixel_pitch=5e-6,
    ...     wavelength=532e-9, image_distance=30e-3, aperture_diameter=1.5e-3)
    >>> f"{sampling.views:.0f} views, {sampling.independent_views:.1f} of them independent"
    '20 views, 9.4 of them independent'
    >>> f"up to {sampling.cutoff / 1e3:.0f} cycles/mm"
    'up to 5 cycles/mm'
    """

    kind: str
    spatial_samples: float
    spatial_share: float
    spatial_pitch: float
    views: float
    angular_step: float
    angular_range: float
    independent_views: float
    nyquist: float
    diffraction_cutoff: float

    @property
    def cutoff(self) -> float:
        """Lower of the Nyquist and diffraction limits, in cycles a metre."""
        return min(self.nyquist, self.diffraction_cutoff)


def type1_sampling(
    *,
    lenslets: float,
    pitch: float,
    diameter: float,
    focal_length: float,
    pixel_pitch: float,
    wavelength: float,
    image_distance: float,
    aperture_diameter: float,
) -> Sampling:
    """Compute the sampling of a standard plenoptic camera (1.0) along one axis.

    Parameters
    ----------
    lenslets : float
        Number of lenslets along the axis.
    pitch, diameter, focal_length : float
        Pitch p, width d and focal length f_mu of the lenslets, in metres.
    pixel_pitch : float
        Pixel pitch of the sensor in metres.
    wavelength : float
        Wavelength in metres.
    image_distance, aperture_diameter : float
        Distance F of the image and aperture D of the main lens, in metres.

    Returns
    -------
    Sampling
        Sampling of ``kind`` "1.0".

    Raises
    ------
    ValueError
        If a number is not positive, or the diameter is larger than the pitch.

    Examples
    --------
    >>> sampling = clplen.analysis.type1_sampling(
    ...     lenslets=100, pitch=100e-6, diameter=100e-6, focal_length=2e-3, pixel_pitch=5e-6,
    ...     wavelength=532e-9, image_distance=30e-3, aperture_diameter=1.5e-3)
    >>> f"{sampling.spatial_samples:.0f} places, {sampling.views:.0f} views"
    '100 places, 20 views'
    """
    _check(
        lenslets=lenslets,
        pitch=pitch,
        diameter=diameter,
        focal_length=focal_length,
        pixel_pitch=pixel_pitch,
        wavelength=wavelength,
        image_distance=image_distance,
        aperture_diameter=aperture_diameter,
    )
    pixels = pitch / pixel_pitch
    return Sampling(
        kind="1.0",
        spatial_samples=float(lenslets),
        spatial_share=1 / pixels,
        spatial_pitch=pitch,
        views=pixels,
        angular_step=pixel_pitch / focal_length,
        angular_range=diameter / focal_length,
        independent_views=independent_views(diameter, focal_length, wavelength, pixels),
        nyquist=1 / (2 * pitch),
        diffraction_cutoff=aperture_diameter / (wavelength * image_distance),
    )


def type2_sampling(
    *,
    lenslets: float,
    pitch: float,
    diameter: float,
    a: float,
    b: float,
    pixel_pitch: float,
    wavelength: float,
    cone: float | None = None,
    pixels: float | None = None,
) -> Sampling:
    """Compute the sampling of a focused plenoptic camera (2.0) along one axis.

    Parameters
    ----------
    lenslets : float
        Number of lenslets along the axis.
    pitch, diameter : float
        Pitch p and width d of the lenslets, in metres.
    a : float
        Distance from the main lens' image to the lenslets in metres; negative for an image behind
        the lenslets (Galilean).
    b : float
        Distance from the lenslets to the sensor in metres.
    pixel_pitch : float
        Pixel pitch of the sensor in metres.
    wavelength : float
        Wavelength in metres.
    cone : float, optional
        Ratio D/F of the main lens; default p/b of the lenslets.
    pixels : float, optional
        Number of pixels along the axis; default the pixels in the lenslets' cells.

    Returns
    -------
    Sampling
        Sampling of ``kind`` "2.0".

    Raises
    ------
    ValueError
        If ``a`` is 0 or not finite, another number not positive, or the diameter above the pitch.

    Examples
    --------
    >>> sampling = clplen.analysis.type2_sampling(
    ...     lenslets=100, pitch=100e-6, diameter=100e-6, a=10e-3, b=2.5e-3, pixel_pitch=5e-6,
    ...     wavelength=532e-9)
    >>> f"{sampling.spatial_samples:.0f} places, {sampling.views:.0f} views"
    '500 places, 4 views'
    """
    if not (fits_float64(a) and a != 0):
        raise ValueError(f"a must be finite and not 0 (negative for Galilean), got {a!r}.")
    _check(
        lenslets=lenslets,
        pitch=pitch,
        diameter=diameter,
        b=b,
        pixel_pitch=pixel_pitch,
        wavelength=wavelength,
    )
    share = b / abs(a)
    cone = pitch / b if cone is None else cone
    pixels = lenslets * pitch / pixel_pitch if pixels is None else pixels
    check_positive(cone=cone, pixels=pixels)
    views = cone * abs(a) / pitch
    return Sampling(
        kind="2.0",
        spatial_samples=pixels * share,
        spatial_share=share,
        spatial_pitch=pixel_pitch / share,
        views=views,
        angular_step=pitch / abs(a),
        angular_range=cone,
        independent_views=views,
        nyquist=share / (2 * pixel_pitch),
        diffraction_cutoff=diameter / (wavelength * abs(a)),
    )


def sampling_of(camera: Any, *, axis: int = 1) -> Sampling:
    """Return the sampling of a plenoptic camera, standard or focused, along one axis.

    Parameters
    ----------
    camera : PlenopticCamera
        Camera, or any object with ``mla``, ``pixel_pitch``, ``wavelength``, ``image_distance`` and
        ``aperture_diameter``, and for a focused camera ``a``, ``b`` and ``grid``.
    axis : int
        Axis: 0 for y, with the pitch and width of a row of a hexagonal array; 1 for x.

    Returns
    -------
    Sampling
        Result of `type1_sampling` or `type2_sampling`.

    Raises
    ------
    TypeError
        If ``camera`` is not a plenoptic camera.
    ValueError
        If ``axis`` is neither 0 nor 1.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> sampling = clplen.analysis.sampling_of(camera)
    >>> sampling.kind, round(sampling.spatial_samples), round(sampling.views)
    ('1.0', 7, 19)
    """
    if axis not in (0, 1):
        raise ValueError(f"axis must be 0 (y) or 1 (x), got {axis!r}.")
    try:
        mla = camera.mla
        common = {
            "lenslets": mla.count[axis],
            "pitch": mla.pitch if axis == 1 else mla.row_pitch,
            "diameter": min(mla.diameter, mla.pitch if axis == 1 else mla.row_pitch),
            "pixel_pitch": camera.pixel_pitch,
            "wavelength": camera.wavelength,
        }
        if camera.kind == "focused":
            cone = camera.aperture_diameter / camera.image_distance
            pixels = camera.grid.shape[axis]
            return type2_sampling(a=camera.a, b=camera.b, cone=cone, pixels=pixels, **common)
        return type1_sampling(
            focal_length=mla.focal_length,
            image_distance=camera.image_distance,
            aperture_diameter=camera.aperture_diameter,
            **common,
        )
    except AttributeError as error:
        raise TypeError(
            f"camera must be a plenoptic camera, got {type(camera).__name__}: {error}."
        ) from error


ROWS = (
    ("places along the axis", "spatial_samples", 1.0, ""),
    ("share of the pixels", "spatial_share", 1.0, ""),
    ("pitch of places", "spatial_pitch", 1e6, "um"),
    ("views of a place", "views", 1.0, ""),
    ("independent views", "independent_views", 1.0, ""),
    ("step of directions", "angular_step", 1e3, "mrad"),
    ("range of directions", "angular_range", 1e3, "mrad"),
    ("Nyquist frequency", "nyquist", 1e-3, "cycles/mm"),
    ("diffraction cut-off", "diffraction_cutoff", 1e-3, "cycles/mm"),
)


def sampling_table(cameras: Mapping[str, Sampling]) -> str:
    """Format the sampling of cameras as a table with a column per camera.

    Parameters
    ----------
    cameras : mapping of str to Sampling
        Sampling of each camera by its name, at least one.

    Returns
    -------
    str
        Text with a quantity and its unit on each line.

    Raises
    ------
    ValueError
        If ``cameras`` is empty.
    TypeError
        If ``cameras`` is not a mapping.

    Examples
    --------
    >>> focused = clplen.analysis.type2_sampling(
    ...     lenslets=100, pitch=100e-6, diameter=100e-6, a=10e-3, b=2.5e-3, pixel_pitch=5e-6,
    ...     wavelength=532e-9)
    >>> print(clplen.analysis.sampling_table({"Keplerian": focused}))
                          Keplerian
    type                        2.0
    places along the axis       500
    share of the pixels        0.25
    pitch of places              20  um
    views of a place              4
    ...
    """
    require(Mapping, cameras, "cameras", "{name: sampling_of(camera)}")
    if not cameras:
        raise ValueError("cameras must contain at least one camera, got none.")
    lines = [["", *cameras, ""]]
    lines.append(["type", *(sampling.kind for sampling in cameras.values()), ""])
    for label, name, unit, text in ROWS:
        values = (getattr(sampling, name) * unit for sampling in cameras.values())
        lines.append([label, *(f"{value:.4g}" for value in values), text])
    return "\n".join(columns(lines, f"<{'>' * len(cameras)}<"))


def _check(**numbers: float) -> None:
    check_positive(**numbers)
    if numbers["diameter"] > numbers["pitch"] * (1 + 1e-12):
        raise ValueError(
            f"diameter must be at most the pitch of {numbers['pitch']:g} m, got "
            f"{numbers['diameter']:g} m."
        )
