"""Lengths are in metres: numbers in another unit are refused, with what was meant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import objects
import pytest

import clplen
from clplen import units
from clplen.compute.device import Device

GRID, MLA, LAM = objects.GRID, objects.MLA, objects.LAM


def field() -> clplen.Field:
    return objects.field(Device.open())


def camera(kind: str = "type1", **more: Any) -> Any:
    words = objects.CAMERA | {"device": Device.open()} | more
    return getattr(clplen.PlenopticCamera, kind)(**words)


def microscope(**more: Any) -> Any:
    return clplen.PlenopticCamera.microscope(
        **objects.MICROSCOPE | {"device": Device.open()} | more
    )


def wave(name: str, *words: Any, **more: Any) -> Any:
    return getattr(clplen.wave, name)(GRID, *words, **{"wavelength": LAM, "device": "cpu"} | more)


# Numbers as people give them in other units, and the length that is meant.
MISTAKES: dict[str, tuple[Callable[[], Any], str]] = {
    "wavelength in nm": (lambda: wave("plane_wave", wavelength=550), "5.5e-07"),
    "beam": (lambda: wave("gaussian_beam", 1e-5, wavelength=10.6), "1.06e-05"),
    "waist in um": (lambda: wave("gaussian_beam", 5e4), "0.05"),
    "field": (
        lambda: clplen.Field.from_array(np.ones((8, 8)), GRID, wavelength=550, device="cpu"),
        "5.5e-07",
    ),
    "plan": (lambda: clplen.Propagator(GRID, 0.1, wavelength=550, device="cpu"), "5.5e-07"),
    "wavelengths": (lambda: clplen.wave.propagate_wavelengths(field(), 1e-4, [550]), "5.5e-07"),
    "grid pitch in um": (
        lambda: clplen.wave.plane_wave(clplen.Grid((8, 8), 6.5), wavelength=LAM, device="cpu"),
        "6.5e-06",
    ),
    "lenslets in um and mm": (lambda: clplen.MicrolensArray(150, 10, count=5), "0.00015"),
    "lenslets of f in mm": (lambda: clplen.MicrolensArray(150e-6, 10, count=5), "0.01"),
    "several f in mm": (
        lambda: clplen.MicrolensArray(150e-6, (2e-3, -10), count=5),
        "0.01",
    ),
    "focal length in mm": (lambda: camera(focal_length=120), "0.12"),
    "image distance in mm": (lambda: camera(image_distance=240), "0.24"),
    "aperture in mm": (lambda: camera(aperture_diameter=60), "0.06"),
    "tube lens in mm": (lambda: microscope(tube_lens=200), "0.2"),
    "cover glass in um": (lambda: clplen.cameras.CoverGlass(150), "150 um are 150e-6"),
    "planes in um": (lambda: clplen.point_images(microscope(), [-40, 40]), "-40e-6"),
    "spectrum in nm": (lambda: clplen.Spectrum.gaussian(550, 30), "550e-9"),
    "cell in um": (lambda: clplen.wave.RandomPhaseMask(66), "6.6e-05"),
    "period in um": (lambda: clplen.wave.grating(field(), 4.0), "4e-06"),
    "thin lens in um": (lambda: clplen.thin_lens(field(), 120_000.0), "0.12"),
    "lens diameter in um": (lambda: clplen.wave.Lens(0.1, diameter=3600.0), "0.0036"),
    "system in mm": (lambda: clplen.wave.imaging_system(120, diameter=0.01), "0.12"),
    "pupil in um": (lambda: clplen.wave.Pupil(3600, 0.24), "0.0036"),
    "aperture in um": (lambda: clplen.aperture(field(), 3600), "0.0036"),
    "ring in um": (lambda: clplen.wave.annular_aperture(field(), 3600, inner=1e-3), "0.0036"),
    "star in um": (lambda: clplen.wave.siemens_star(GRID, 8, diameter=3600), "0.0036"),
    "plate in um": (lambda: clplen.phase_plate(field(), {4: 1e-7}, diameter=3600), "0.0036"),
    "plate's wavefront in um": (
        lambda: clplen.phase_plate(field(), {4: 0.1}, diameter=5e-6),
        "1e-07",
    ),
    "wavefront in nm": (lambda: clplen.cameras.Aberrations(main_lens={4: 100}), "1e-07"),
    "circle in um": (
        lambda: clplen.cameras.Aberrations(lenslets={4: 1e-7}, lenslet_circle=150),
        "0.00015",
    ),
    "points in um": (lambda: clplen.PointSources([(0, 0, 0)], diameter=10), "1e-05"),
}


def test_a_number_in_another_unit_is_refused_with_what_was_meant() -> None:
    for mistake in MISTAKES:
        make, meant = MISTAKES[mistake]
        with pytest.raises(ValueError) as error:  # noqa: PT011 - the message is looked at below
            make()
        words = str(error.value)
        assert "\n" not in words
        assert words.endswith((f"; did you mean {meant}?", f"did you mean {meant}?", f"{meant}."))
        assert "metres" in words or "m thick" in words


# Extremes that exist: none of them is refused.
EXTREMES: dict[str, Callable[[], Any]] = {
    "gamma rays": lambda: wave("plane_wave", wavelength=1e-12),
    "millimetre waves": lambda: wave("plane_wave", wavelength=3e-3),
    "terahertz": lambda: wave("plane_wave", wavelength=300e-6),
    "radio waves": lambda: wave("plane_wave", wavelength=0.21),
    "a dish of 500 m": lambda: clplen.aperture(
        clplen.wave.plane_wave(clplen.Grid((600, 1), 1.0), wavelength=0.21, device="cpu"), 500.0
    ),
    "a mirror of 10 m": lambda: clplen.wave.Lens(17.5, diameter=10.0),
    "a kilometre and a hundred": lambda: clplen.propagate(field(), 1e5, method="fresnel-1fft"),
    "a weak lens": lambda: clplen.thin_lens(field(), 5e4),
    "no lens": lambda: clplen.thin_lens(field(), np.inf),
    "a telescope": lambda: clplen.wave.imaging_system(50.0, diameter=10.0),
    "a camera of f = 15 m": lambda: camera(
        focal_length=15.0,
        object_distance=1e9,
        mla=clplen.MicrolensArray(1e-3, 0.1, count=5),
        aperture_diameter=4e-3,
        pixels_per_lenslet=40,
    ),
    "lenses of an array of cameras": lambda: clplen.MicrolensArray(0.1, 0.5, count=3),
    "lenslets of a wavefront sensor": lambda: clplen.MicrolensArray(10e-3, 2.0, count=3),
    "lenslets of a stack": lambda: clplen.MicrolensArray(3e-6, 10e-6, count=3),
    "a bead": lambda: clplen.PointSources([(0, 0, 0)], diameter=100e-9),
    "a star": lambda: clplen.PointSources([(0, 0, 4e16)], diameter=0.0),
}


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
def test_what_exists_is_not_refused() -> None:
    for extreme in EXTREMES:
        EXTREMES[extreme]()


def test_the_bounds_fit_together() -> None:
    for kind in [name for name in vars(units) if isinstance(getattr(units, name), units.Length)]:
        one = getattr(units, kind)
        low, high = one.usual
        assert 0 < low < high <= one.max_length or not one.units
        one.check([0.0, one.max_length, -one.max_length, np.inf, np.nan], "It")
        one.check("words", "It")  # which others refuse
        with pytest.raises(ValueError, match=r"^It must be in metres, at most .*, got 1e\+30\.$"):
            one.check([0.0, -1e30], "It")
