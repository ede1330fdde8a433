"""How a plenoptic camera shares its pixels between place and direction.

Ng, Levoy, Bredif, Duval, Horowitz and Hanrahan 2005, for the standard camera (1.0): one spatial
sample a lenslet, one direction a pixel under it. Lumsdaine and Georgiev 2009 and Georgiev and
Lumsdaine 2010 for the focused one (2.0), whose lenslets see the main lens' image at distance a and
throw it on the sensor at distance b: with m = b/a, abs(m) of the sensor's resolution in place, and
1/abs(m) views of every point where main lens and lenslets have the same f-number.
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
    """Samples of one axis; places are on the plane of the main lens' image, all in metres.

    Attributes
    ----------
    kind : str
        "1.0" or "2.0".
    spatial_samples : float
        Places: lenslets (1.0), pixels times abs(m) (2.0).
    spatial_share : float
        Places over the pixels of the sensor.
    spatial_pitch : float
        Between places: the lenslets' pitch (1.0), a pixel over abs(m) (2.0).
    views : float
        Directions in which a place is seen: pixels a lenslet (1.0), lenslets that its light meets,
        D abs(a)/(F p), which is 1/abs(m) where the main lens has the lenslets' f-number b/p (2.0).
    angular_step : float
        Between directions, in radians: pixel/f_mu (1.0), p/abs(a) (2.0).
    angular_range : float
        All directions, in radians: d/f_mu, those a lenslet takes (1.0); D/F, those that the main
        lens passes (2.0).
    independent_views : float
        Directions that diffraction by the lenslet leaves independent: d^2/(lam f_mu), at most the
        pixels a lenslet (1.0); the views themselves (2.0), since other lenslets see them.
    nyquist : float
        Highest spatial frequency of the samples, 1/(2 spatial_pitch), cycles a metre.
    diffraction_cutoff : float
        Highest spatial frequency of the light: D/(lam F) of the main lens (1.0), d/(lam abs(a)) of
        the lenslet (2.0), cycles a metre.

    Examples
    --------
    >>> found = clplen.analysis.type1_sampling(
    ...     lenslets=100, pitch=100e-6, diameter=100e-6, focal_length=2e-3, pixel_pitch=5e-6,
    ...     wavelength=532e-9, image_distance=30e-3, aperture_diameter=1.5e-3)
    >>> f"{found.views:.0f} views, {found.independent_views:.1f} of them independent"
    '20 views, 9.4 of them independent'
    >>> f"up to {found.cutoff / 1e3:.0f} cycles/mm"
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
        """The lower of the two limits in cycles a metre."""
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
        How many there are along the axis.
    pitch, diameter, focal_length : float
        Pitch p, width d and focal length f_mu of the lenslets, in metres.
    pixel_pitch : float
        Of the sensor, in metres.
    wavelength : float
        In metres.
    image_distance, aperture_diameter : float
        Distance F of the image and aperture D of the main lens, in metres.

    Returns
    -------
    Sampling
        Of ``kind`` "1.0".

    Raises
    ------
    ValueError
        If a number is not positive, or a lenslet wider than its pitch.

    Examples
    --------
    >>> found = clplen.analysis.type1_sampling(
    ...     lenslets=100, pitch=100e-6, diameter=100e-6, focal_length=2e-3, pixel_pitch=5e-6,
    ...     wavelength=532e-9, image_distance=30e-3, aperture_diameter=1.5e-3)
    >>> f"{found.spatial_samples:.0f} places, {found.views:.0f} views"
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
        How many there are along the axis.
    pitch, diameter : float
        Pitch p and width d of the lenslets, in metres.
    a : float
        Main lens' image to lenslets, in metres; negative when it lies behind them (Galilean).
    b : float
        Lenslets to sensor, in metres.
    pixel_pitch : float
        Of the sensor, in metres.
    wavelength : float
        In metres.
    cone : float, optional
        D/F of the main lens; default p/b, that of the lenslets.
    pixels : float, optional
        Of the sensor along the axis; default those of the lenslets' cells.

    Returns
    -------
    Sampling
        Of ``kind`` "2.0".

    Raises
    ------
    ValueError
        If ``a`` is 0 or not finite, another number not positive, or a lenslet wider than its pitch.

    Examples
    --------
    >>> found = clplen.analysis.type2_sampling(
    ...     lenslets=100, pitch=100e-6, diameter=100e-6, a=10e-3, b=2.5e-3, pixel_pitch=5e-6,
    ...     wavelength=532e-9)
    >>> f"{found.spatial_samples:.0f} places, {found.views:.0f} views"
    '500 places, 4 views'
    """
    if not (fits_float64(a) and a != 0):
        raise ValueError(f"a is finite and not 0, negative for a Galilean camera, not {a!r}.")
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
        Or anything with ``mla``, ``pixel_pitch``, ``wavelength``, ``image_distance`` and
        ``aperture_diameter``, and for a focused one ``a``, ``b`` and ``grid``.
    axis : int
        0 along y, where the rows of a hexagonal array count with the pitch and width of a row;
        1 along x.

    Returns
    -------
    Sampling
        As `type1_sampling` or `type2_sampling` computes it.

    Raises
    ------
    TypeError
        If it is no such camera.
    ValueError
        If the axis is neither.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> found = clplen.analysis.sampling_of(camera)
    >>> found.kind, round(found.spatial_samples), round(found.views)
    ('1.0', 7, 19)
    """
    if axis not in (0, 1):
        raise ValueError(f"axis is 0 for y or 1 for x, not {axis!r}.")
    try:
        mla = camera.mla
        given = {
            "lenslets": mla.count[axis],
            "pitch": mla.pitch if axis == 1 else mla.row_pitch,
            "diameter": min(mla.diameter, mla.pitch if axis == 1 else mla.row_pitch),
            "pixel_pitch": camera.pixel_pitch,
            "wavelength": camera.wavelength,
        }
        if camera.kind == "focused":
            cone = camera.aperture_diameter / camera.image_distance
            pixels = camera.grid.shape[axis]
            return type2_sampling(a=camera.a, b=camera.b, cone=cone, pixels=pixels, **given)
        return type1_sampling(
            focal_length=mla.focal_length,
            image_distance=camera.image_distance,
            aperture_diameter=camera.aperture_diameter,
            **given,
        )
    except AttributeError as error:
        raise TypeError(
            f"{type(camera).__name__} is no plenoptic camera of type 1 or 2: {error}."
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
    """Return a table of the sampling of cameras, one a column.

    Parameters
    ----------
    cameras : mapping of str to Sampling
        Sampling of each camera by its name, at least one.

    Returns
    -------
    str
        Lines of text, one for each quantity, with its unit at the end.

    Raises
    ------
    ValueError
        If there is none.
    TypeError
        If it is no mapping.

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
        raise ValueError("A table of sampling needs at least one camera.")
    lines = [["", *cameras, ""]]
    lines.append(["type", *(one.kind for one in cameras.values()), ""])
    for label, name, unit, text in ROWS:
        values = (getattr(one, name) * unit for one in cameras.values())
        lines.append([label, *(f"{value:.4g}" for value in values), text])
    return "\n".join(columns(lines, f"<{'>' * len(cameras)}<"))


def _check(**numbers: float) -> None:
    check_positive(**numbers)
    if numbers["diameter"] > numbers["pitch"] * (1 + 1e-12):
        raise ValueError(
            f"A lenslet of {numbers['diameter']:g} m is wider than its pitch of "
            f"{numbers['pitch']:g} m."
        )
