"""Plenoptic cameras by their parameters: what `PlenopticCamera` makes of lengths and an array."""

from __future__ import annotations

import math
from abc import ABC
from collections.abc import Mapping
from typing import Any, Literal, cast

from clplen import units
from clplen.cameras.focused_camera import Plenoptic2, magnification, matched_aperture
from clplen.cameras.fourier.fourier_microscope import FourierMicroscope
from clplen.cameras.fourier.lenslet_layout import LensletLayout
from clplen.cameras.fourier.making import make as make_fourier_microscope
from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics import microscope_optics
from clplen.cameras.optics.camera_aberrations import NONE, Aberrations
from clplen.cameras.optics.lenslet_camera import Described, Kind, LensletCamera, sensor_grid
from clplen.cameras.optics.objective import APODISATION, CoverGlass
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.optics.pupil_aberration import PupilAberration
from clplen.cameras.optics.ray_optics import LensModel, thin_spherical
from clplen.cameras.standard_camera import Plenoptic1
from clplen.checks import is_finite
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import SamplingError, SamplingWarning, warn_caller
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.spectrum.spectrum_tables import check_wavelength

QUARTER = 0.25  # of a wave, below which a thin lens is as good as a corrected one (Rayleigh)
SCALAR_NA = 0.4  # above which the polarisation of light matters (Stamnes 1986, section 16.3)
NARROWEST = 2.0  # wavelengths across a lenslet
LEAST_PATCH = 0.1  # pixels that pictures of neighbouring lenslets move by
PITCH_TOLERANCE = 1e-6  # relative, between pixels a lenslet and their pitch
LENS_LAW_TOLERANCE = 1e-6  # relative, of 1/f = 1/object + 1/image


_LENGTHS = {
    "focal_length": units.CAMERA_FOCAL_LENGTH,
    "image_distance": units.CAMERA_FOCAL_LENGTH,
    "aperture_diameter": units.CAMERA_DIAMETER,
    "tube_lens": units.TUBE_LENS,
}  # an object may be anywhere, and wavelengths have a check of their own


class PlenopticCamera(Described, LensletCamera, ABC):
    """A plenoptic camera simulated by wave optics: made by `type1`, `type2` or `microscope`.

    Every camera that these make is an instance of it, and says by its ``kind`` which one it is.

    Attributes
    ----------
    kind : {"standard", "focused", "microscope"}
        Which camera it is.
    focal_length, object_distance, image_distance, aperture_diameter, wavelength : float
        In metres.
    others
        Those of `LensletCamera`.

    Examples
    --------
    >>> mla = clplen.MicrolensArray(100e-6, 1e-3, count=11)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=mla, wavelength=550e-9, pixels_per_lenslet=5)
    >>> camera.kind, isinstance(camera, clplen.PlenopticCamera)
    ('standard', True)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 1e-3)))
    >>> raw.shape, f"alpha = {camera.alpha(1e-3):.3f}"
    ((55, 55), 'alpha = 1.048')
    """

    kind: Kind
    focal_length: float
    object_distance: float
    image_distance: float
    aperture_diameter: float
    wavelength: float

    def __init__(self) -> None:
        raise TypeError(
            "A camera is made by PlenopticCamera.type1(...), .type2(...) or .microscope(...)."
        )

    @staticmethod
    def type1(
        *,
        focal_length: float,
        mla: MicrolensArray,
        wavelength: float,
        pixels_per_lenslet: float | None = None,
        device: DeviceLike | None = None,
        object_distance: float | None = None,
        image_distance: float | None = None,
        aperture_diameter: float | None = None,
        field_lens: bool = False,
        aberrations: Aberrations = NONE,
        pixels: PixelArray | None = None,
        lens_model: Literal["auto", "thin", "corrected"] = "auto",
    ) -> Plenoptic1:
        """A standard plenoptic camera: array on the main lens' image, sensor f_mu behind it.

        Parameters
        ----------
        focal_length : float
            Of the main lens in metres.
        mla : MicrolensArray
            Brings pitch, f_mu, count, lattice, fill, offset and rotation.
        wavelength : float
            In metres.
        pixels_per_lenslet : float, optional
            At least 2; may be fractional. Not needed where ``pixels`` has a pitch.
        device : Device or str, optional
            Where the simulation runs; None is ``Device.open()``.
        object_distance, image_distance : float, optional
            Main lens to focused object plane, and to the array, in metres. Neither: 2f and 2f.
            One: the other by the lens law.
        aperture_diameter : float, optional
            Of the main lens in metres; None matches the f-numbers: pitch F/f_mu.
        field_lens : bool
            A lens of focal length F at the array puts the exit pupil at infinity.
        aberrations : Aberrations
            What departs from this design: wavefronts, lenslets out of place, a sensor moved.
        pixels : PixelArray, optional
            Pixels that integrate the light on their area, and where they lie. None: pixels that
            cover the array and take the intensity in their middle, where they sample the light's
            waves; else ``PixelArray()``.
        lens_model : {"auto", "thin", "corrected"}
            The main lens as a quadratic phase, or as a lens that images every point without
            aberrations and obeys the sine condition. "auto": "thin" where its own spherical
            aberration is below a quarter of a wave.

        Returns
        -------
        Plenoptic1

        Raises
        ------
        ValueError
            For a length that is not positive, distances that contradict the lens law, lenslets
            of several focal lengths, or aberrations that do not fit.
        SamplingError
            If a lenslet has less than 2 pixels.

        Warns
        -----
        SamplingWarning
            If the numerical aperture D/(2 F) of the main lens is above .4: waves are scalar.
        """
        device = as_device(device)
        z_obj, F = _distances(
            mla, wavelength, focal_length, object_distance, image_distance,
            aperture_diameter,
        )  # fmt: skip
        if len(mla.focal_lengths) > 1:
            raise ValueError(
                f"The sensor of a 1.0 camera lies f_mu behind its lenslets, which here have "
                f"{len(mla.focal_lengths)} focal lengths: give one, or use PlenopticCamera.type2."
            )
        D = mla.pitch * F / mla.focal_length if aperture_diameter is None else aperture_diameter
        _check_aperture(D, F)
        shared = _shared(focal_length, wavelength, mla, pixels_per_lenslet, pixels, device)
        camera = Plenoptic1(
            object_distance=z_obj,
            image_distance=F,
            aperture_diameter=float(D),
            field_lens=bool(field_lens),
            lens_model=_lens_model(lens_model, D, z_obj, F, wavelength),
            **shared,
        )
        return camera.with_aberrations(aberrations)

    @staticmethod
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
        """A focused plenoptic camera: its lenslets image the main lens' image onto the sensor.

        1/a + 1/b = 1/f_mu and m = b/a, so that a = f_mu (1 + 1/m) and b = f_mu (1 + m) (Lumsdaine
        and Georgiev 2009). Keplerian, m > 0: the array lies a behind the image at F, b > f_mu.
        Galilean, -1 < m < 0: abs(a) before it, b < f_mu.

        Parameters
        ----------
        focal_length : float
            Of the main lens in metres.
        mla : MicrolensArray
            Brings pitch, f_mu, count, lattice, fill, offset and rotation. With several focal
            lengths the first one's m and a are given; the others are in focus at
            1/a = 1/f_mu - 1/b.
        wavelength : float
            In metres.
        pixels_per_lenslet : float, optional
            At least 2; may be fractional. Not needed where ``pixels`` has a pitch.
        device : Device or str, optional
            Where the simulation runs; None is ``Device.open()``.
        m, a : float, optional
            Exactly one of them: magnification of the lenslets, or the distance from the main
            lens' image to the array in metres (above f_mu or negative).
        object_distance, image_distance : float, optional
            Main lens to focused object plane, and to its image (not to the array), in metres.
            Neither: 2f and 2f. One: the other by the lens law.
        aperture_diameter : float, optional
            Of the main lens in metres; None: by ``match``.
        match : {"pupil", "cone"}
            D = p z2/b, z2 = F + a, so that the image of the pupil fills a cell; or p F/b.
        aberrations : Aberrations
            What departs from this design, as for `type1`.
        pixels : PixelArray, optional
            As for `type1`.
        lens_model : {"auto", "thin", "corrected"}
            As for `type1`.

        Returns
        -------
        Plenoptic2

        Raises
        ------
        ValueError
            For a length that is not positive, distances that contradict the lens law, m = 0 or
            m <= -1, a within f_mu, both or none of m and a, an array before the main lens,
            another match, or for aberrations that do not fit.
        TypeError
            If m or a is no number.
        SamplingError
            If a lenslet has less than 2 pixels.

        Warns
        -----
        SamplingWarning
            As `type1`.
        """
        device = as_device(device)
        z_obj, F = _distances(
            mla, wavelength, focal_length, object_distance, image_distance,
            aperture_diameter,
        )  # fmt: skip
        m = magnification(mla.focal_length, m, a)
        z2, b = F + mla.focal_length * (1 + 1 / m), mla.focal_length * (1 + m)
        D = matched_aperture(match, pitch=mla.pitch, F=F, z2=z2, b=b)
        D = float(D if aperture_diameter is None else aperture_diameter)
        _check_aperture(D, F)
        shared = _shared(focal_length, wavelength, mla, pixels_per_lenslet, pixels, device)
        camera = Plenoptic2(
            object_distance=z_obj,
            image_distance=F,
            aperture_diameter=D,
            field_lens=False,
            m=float(m),
            lens_model=_lens_model(lens_model, D, z_obj, F, wavelength),
            **shared,
        )
        if camera.patch_size < LEAST_PATCH:
            raise ValueError(
                f"m = {m:.3g} (a = {camera.a:g} m) moves the lenslets' pictures by "
                f"{camera.patch_size:.2g} pixels from lenslet to lenslet: lengths are in metres; "
                f"abs(m) of {_least_m(mla.focal_length, F, camera.pixels_per_lenslet):.2g} or more "
                "would do."
            )
        return camera.with_aberrations(aberrations)

    @staticmethod
    def microscope(
        *,
        magnification: float,
        na: float,
        mla: MicrolensArray,
        wavelength: float,
        pixels_per_lenslet: float | None = None,
        device: DeviceLike | None = None,
        medium_index: float = 1.0,
        tube_lens: float = 0.200,
        cover: CoverGlass | None = None,
        apodisation: float = APODISATION,
        pixels: PixelArray | None = None,
        pupil: PupilAberration | Mapping[int, float] | None = None,
    ) -> Microscope:
        """A light-field microscope: array on the native image plane, sensor f_mu behind it.

        The objective obeys the sine condition; the image side is telecentric. It is matched where
        the f-numbers M/(2 NA) and f_mu/d agree (Levoy et al. 2006).

        Parameters
        ----------
        magnification : float
            M of objective and tube lens, at least 1.
        na : float
            Numerical aperture, below ``medium_index``.
        mla : MicrolensArray
            Brings pitch, f_mu, count, lattice, fill, offset and rotation. Of several focal lengths
            the first is f_mu, in which the sensor lies.
        wavelength : float
            Of the fluorescence in vacuum, in metres.
        pixels_per_lenslet : float, optional
            At least 2; may be fractional. Not needed where ``pixels`` has a pitch.
        device : Device or str, optional
            Where the simulation runs; None is ``Device.open()``.
        medium_index : float
            Of the medium with the specimen, 1 (air) or more.
        tube_lens : float
            Its focal length in metres; that of the objective is tube_lens/M.
        cover : CoverGlass, optional
            A cover glass of another thickness or index than the objective is made for.
        apodisation : float
            e of the amplitude cos(theta)^e over the pupil, -1 to 1. Of points that shine alike in
            all directions behind an objective that obeys the sine condition it is -1/2, the
            cos^(1/2) sin(theta) of the Debye integral over angles (Broxton et al. 2013).
        pixels : PixelArray, optional
            Pixels that integrate the light on their area, and where they lie. None: pixels that
            cover the array and take the intensity in their middle.
        pupil : PupilAberration or mapping of int to float, optional
            Aberrations of objective and sample: Noll's index to metres of path, rms over the pupil.

        Returns
        -------
        Microscope

        Raises
        ------
        ValueError
            For a length or number outside its range, NA at or above the index, or lenslets that
            do not converge.
        TypeError
            If array, cover glass or pupil are none.
        SamplingError
            If a lenslet has less than 2 pixels, or pixels that do not integrate cannot sample the
            light.

        Warns
        -----
        SamplingWarning
            If the two f-numbers differ by more than 10 %.
        """
        device = as_device(device)
        _require_lengths(wavelength=wavelength, tube_lens=tube_lens)
        check_wavelength(wavelength)
        _check_lenslets(mla, wavelength)
        _check_objective(magnification, na, medium_index, mla)
        if not (is_finite(apodisation) and -1 <= apodisation <= 1):
            raise ValueError(
                f"apodisation is the power of cos(theta) over the pupil, from -1 to 1, not "
                f"{apodisation!r}."
            )
        if cover is not None and not isinstance(cover, CoverGlass):
            raise TypeError(f"cover is a CoverGlass, as CoverGlass(150e-6), not {cover!r}.")
        if cover is not None and na >= min(cover.index, cover.designed_index):
            raise ValueError(
                f"NA {na!r} does not pass a cover glass of index "
                f"{min(cover.index, cover.designed_index)!r}."
            )
        if pupil is not None and not isinstance(pupil, PupilAberration):
            pupil = PupilAberration(pupil)
        across = _pixels_per_lenslet(mla, pixels_per_lenslet, pixels)
        if pixels is not None:
            mla = pixels.turned(mla)
        grid = sensor_grid(mla, across, pixels)
        camera = Microscope(
            magnification=float(magnification),
            na=float(na),
            medium_index=float(medium_index),
            tube_lens=float(tube_lens),
            mla=mla,
            wavelength=float(wavelength),
            pixels_per_lenslet=float(across),
            pixel_pitch=grid.pitch[1],
            grid=grid,
            device=device,
            cover=cover,
            apodisation=float(apodisation),
            pixels=pixels,
            pupil=pupil,
        )
        if pixels is None:
            microscope_optics.check_sampling(camera)
        if abs(camera.matched - 1) > microscope_optics.MISMATCH:
            warn_caller(
                f"The f-numbers of objective and lenslets differ: M/(2 NA) = "
                f"{magnification / (2 * na):.4g}, f_mu/d = "
                f"{mla.focal_length / mla.diameter:.4g}; sub-images "
                + ("overlap." if camera.matched < 1 else "leave part of their cells dark."),
                SamplingWarning,
            )
        return camera

    @staticmethod
    def fourier_microscope(
        *,
        magnification: float,
        na: float,
        mla: MicrolensArray | LensletLayout,
        wavelength: float,
        relay: float,
        pixel_pitch: float,
        shape: tuple[int, int] | None = None,
        field_stop: float | None = None,
        sensor_distance: float | None = None,
        device: DeviceLike | None = None,
        medium_index: float = 1.0,
        tube_lens: float = 0.200,
        cover: CoverGlass | None = None,
        apodisation: float = APODISATION,
    ) -> FourierMicroscope:
        """A Fourier light-field microscope (FLFM, XLFM): lenslets on the conjugate pupil.

        Objective, tube lens, field stop on the native image, relay lens, lenslets one focal length
        behind it, sensor. Each lenslet shows the specimen from its own angle (Llavador et al. 2016;
        Guo et al. 2019; with two focal lengths Cong et al. 2017).

        Parameters
        ----------
        magnification : float
            M of objective and tube lens, at least 1.
        na : float
            Numerical aperture, below ``medium_index``.
        mla : MicrolensArray or LensletLayout
            Lenslets on a lattice, or anywhere; of one or several focal lengths.
        wavelength : float
            Of the fluorescence in vacuum, in metres.
        relay : float
            f_FL in metres, of the relay (Fourier) lens.
        pixel_pitch : float
            Of the sensor in metres; pixels integrate over their area.
        shape : tuple of int, optional
            (ny, nx) pixels of the sensor, its middle on the axis; default as many as the
            sub-images with light take.
        field_stop : float, optional
            Diameter in metres, on the native image; default d f_FL/s, which makes sub-images as
            wide as lenslets.
        sensor_distance : float, optional
            s in metres, from lenslets to sensor; default their focal length.
        device : Device or str, optional
            Where the simulation runs; None is ``Device.open()``.
        medium_index : float
            Of the medium with the specimen, 1 (air) or more.
        tube_lens : float
            Its focal length in metres; that of the objective is tube_lens/M.
        cover : CoverGlass, optional
            A cover glass of another thickness or index than the objective is made for.
        apodisation : float
            e of the amplitude cos(theta)^e over the pupil, -1 to 1, as of `microscope`.

        Returns
        -------
        FourierMicroscope
            A camera of its own: its frames are pictures, and no raw images of a light field.

        Raises
        ------
        ValueError
            For a length or number outside its range, NA at or above the index, no lenslet in the
            pupil, or several focal lengths without ``sensor_distance``.
        TypeError
            If array or cover glass are none.
        SamplingError
            If a sub-image has less than 8 pixels.
        ShapeError
            If ``shape`` is not two positive integers.
        """
        return make_fourier_microscope(
            magnification=magnification,
            na=na,
            mla=mla,
            wavelength=wavelength,
            relay=relay,
            pixel_pitch=pixel_pitch,
            shape=shape,
            field_stop=field_stop,
            sensor_distance=sensor_distance,
            medium_index=medium_index,
            tube_lens=tube_lens,
            cover=cover,
            apodisation=apodisation,
            device=device,
        )


for _camera in (Plenoptic1, Plenoptic2, Microscope):
    PlenopticCamera.register(_camera)


def _check_objective(magnification: float, na: float, index: float, mla: MicrolensArray) -> None:
    """Refuse an objective that cannot be, and lenslets that do not converge."""
    if not (is_finite(magnification) and magnification >= 1):
        raise ValueError(f"The magnification is a finite number from 1 on, not {magnification!r}.")
    if not (is_finite(index) and index >= 1):
        raise ValueError(f"medium_index is a finite number from 1 (air) on, not {index!r}.")
    if not (is_finite(na) and 0 < na < index):
        raise ValueError(
            f"NA = n sin(theta) lies between 0 and the index of the medium, {index!r}, not at "
            f"{na!r}: give medium_index (water 1.33, oil 1.52) or another NA."
        )
    if min(mla.focal_lengths) <= 0:
        raise ValueError(
            f"The lenslets of a microscope have focal lengths > 0, not {mla.focal_lengths}."
        )
    if mla.map is not None and mla.map.is_of_each:
        raise ValueError(
            "The lenslets of a microscope are alike, so that its point images repeat: give one map "
            "for all, not one for each."
        )


def _distances(
    mla: MicrolensArray,
    wavelength: float,
    focal_length: float,
    object_distance: float | None,
    image_distance: float | None,
    aperture_diameter: float | None,
) -> tuple[float, float]:
    """Object and image distance, after a look at everything that both cameras are given."""
    _require_lengths(
        focal_length=focal_length,
        wavelength=wavelength,
        object_distance=object_distance,
        image_distance=image_distance,
        aperture_diameter=aperture_diameter,
    )
    check_wavelength(wavelength)
    _check_lenslets(mla, wavelength)
    if min(mla.focal_lengths) <= 0:
        raise ValueError(
            f"The lenslets of a camera converge: f > 0, not {min(mla.focal_lengths)!r}."
        )
    distances = _lens_law(focal_length, object_distance, image_distance)
    longest = max(mla.focal_lengths)
    if longest >= distances[1]:
        meant = units.LENSLET_FOCAL_LENGTH.meant(longest)
        raise ValueError(
            f"The lenslets' focal length of {longest:g} m is not shorter than the image distance "
            f"of the main lens, {distances[1]:g} m{meant}"
        )
    return distances


def _check_lenslets(mla: MicrolensArray, wavelength: float) -> None:
    """Refuse what is no array, or one whose lenslets are too narrow for the wavelength."""
    if not isinstance(mla, MicrolensArray):
        raise TypeError(f"mla is a MicrolensArray, not {mla!r}.")
    width = mla.pitch if mla.gap == "clear" else mla.diameter
    if width < NARROWEST * wavelength:
        raise ValueError(
            f"Lenslets of {width:g} m are no lenses for a wavelength of {wavelength:g} m: "
            f"lengths are in metres; wavelengths below {width / NARROWEST:g} m would do."
        )


def _least_m(f: float, F: float, pixels: float) -> float:
    """m of the smallest patch, m pixels F/(F + f + f/m), of a Keplerian camera."""
    linear, square = LEAST_PATCH * (F + f), pixels * F
    return (linear + math.sqrt(linear**2 + 4 * square * LEAST_PATCH * f)) / (2 * square)


def _check_aperture(D: float, F: float) -> None:
    """Refuse an aperture that no lens has; warn of one that scalar waves do not describe well.

    The numerical aperture at the image of a lens that obeys the sine condition is D/(2 F), below 1.
    """
    na = D / (2 * F)
    if na >= 1:
        meant = units.CAMERA_DIAMETER.meant(D).rstrip(".") if D > 1 else ""
        raise ValueError(
            f"An aperture of {D:g} m and its image {F:g} m away would be NA {na:.3g}, and no lens "
            f"has 1 or more: below {2 * F:g} m would do{meant or '.'}"
        )
    if na > SCALAR_NA:
        warn_caller(
            f"The main lens has NA {na:.3g} at its image, D/(2 F) above {SCALAR_NA:g}: waves here "
            f"are scalar, without polarisation; D of {2 * F * SCALAR_NA:.3g} m or less would do.",
            SamplingWarning,
        )


def _shared(
    focal_length: float,
    wavelength: float,
    mla: MicrolensArray,
    pixels_per_lenslet: float | None,
    pixels: PixelArray | None,
    device: Device,
) -> dict[str, Any]:
    """Fields of both cameras that are as given, and the sensor's."""
    across = _pixels_per_lenslet(mla, pixels_per_lenslet, pixels)
    if pixels is not None:
        mla = pixels.turned(mla)
    grid = sensor_grid(mla, across, pixels)
    return {
        "focal_length": float(focal_length),
        "mla": mla,
        "wavelength": float(wavelength),
        "pixels_per_lenslet": float(across),
        "pixel_pitch": grid.pitch[1],
        "grid": grid,
        "device": device,
        "pixels": pixels,
    }


def _pixels_per_lenslet(
    mla: MicrolensArray, given: float | None, pixels: PixelArray | None
) -> float:
    """Pixels a lenslet, from their number or their pitch."""
    if pixels is not None and not isinstance(pixels, PixelArray):
        raise TypeError(f"pixels is a PixelArray, as PixelArray(), not {pixels!r}.")
    pitch = None if pixels is None else pixels.pitch
    if given is None and pitch is None:
        raise ValueError(
            "The pixels have no size: give pixels_per_lenslet, or pixels=PixelArray(pitch=...)."
        )
    if given is not None and not (is_finite(given) and given > 0):
        raise SamplingError(f"pixels_per_lenslet is a number, at least 2, not {given!r}.")
    if pitch is None:
        assert given is not None
        return given
    across = mla.pitch / pitch
    if given is not None and abs(given - across) > PITCH_TOLERANCE * across:
        raise ValueError(
            f"pixels_per_lenslet = {given!r} contradicts the pixels' pitch of {pitch:g} m, of "
            f"which a lenslet of {mla.pitch:g} m has {across:.6g}: give one of the two."
        )
    return across


def _lens_model(
    given: str, D: float, object_distance: float, image_distance: float, wavelength: float
) -> LensModel:
    """The model of the main lens."""
    if given not in ("auto", "thin", "corrected"):
        raise ValueError(f"lens_model is 'auto', 'thin' or 'corrected', not {given!r}.")
    if given != "auto":
        return cast(LensModel, given)
    spherical = thin_spherical(D, object_distance, image_distance)
    return "thin" if spherical < QUARTER * wavelength else "corrected"


def _require_lengths(**given: float | None) -> None:
    """Refuse lengths that are not positive and finite, or no metres; None is left out."""
    for name, value in given.items():
        if value is not None and not (is_finite(value) and value > 0):
            raise ValueError(f"{name} is positive, in metres, not {value!r}.")
        if value is not None and name in _LENGTHS:
            _LENGTHS[name].check(value, name)


def _lens_law(
    f: float, object_distance: float | None, image_distance: float | None
) -> tuple[float, float]:
    """Object and image distance that satisfy 1/f = 1/object + 1/image, in metres.

    Neither given: 2f and 2f. One given: the other follows.
    """
    for name, distance in (("object", object_distance), ("image", image_distance)):
        if distance is not None and distance <= f:
            raise ValueError(
                f"{name}_distance = {distance:g} m is within the focal length of {f:g} m: there is "
                "no real image."
            )
    if object_distance is None:
        if image_distance is None:
            return (2 * f, 2 * f)
        return (1 / (1 / f - 1 / image_distance), float(image_distance))
    if image_distance is None:
        return (float(object_distance), 1 / (1 / f - 1 / object_distance))
    if abs(f / object_distance + f / image_distance - 1) > LENS_LAW_TOLERANCE:
        fits = 1 / (1 / f - 1 / object_distance)
        raise ValueError(
            f"object_distance = {object_distance:g} m and image_distance = {image_distance:g} m "
            f"contradict the lens law for f = {f:g} m: this object is imaged at {fits:.6g} m. Give "
            "one of the two."
        )
    return (float(object_distance), float(image_distance))
