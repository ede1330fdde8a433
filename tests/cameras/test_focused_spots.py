"""What the lenslets of a focused camera show of a point, by waves: pitch, views, width, places."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from reference_spots import slope, spot, width

from clplen import MicrolensArray, PlenopticCamera, PointSources
from clplen.cameras.focused_camera import Plenoptic2
from clplen.compute.device import Device

pytestmark = pytest.mark.thorough

LAM, PITCH = 532e-9, 150e-6
MIDDLE = PointSources((0, 0, 0))


def camera_of(device: Device, m: float, *, f: float = 10e-3, count: int = 61) -> Plenoptic2:
    """f = 120 mm in 2f-2f, square lenslets of 30 pixels; cone match for lenslets of 3 mm."""
    return PlenopticCamera.type2(
        focal_length=0.12, mla=MicrolensArray(PITCH, f, count=count, fill="full"), wavelength=LAM,
        pixels_per_lenslet=30, device=device, m=m, match="pupil" if f == 10e-3 else "cone",
    )  # fmt: skip


# m, lenslets above half of the brightest in the row, m from the pitch, FWHM of the middle spot
TABLE = [
    (0.5, 1, 0.416, 47.1),
    (0.1, 13, 0.0998, 33.5),
    (-0.3, None, -0.3043, None),
]


@pytest.mark.parametrize(("m", "bright", "pitch", "fwhm"), TABLE)
def test_a_point_in_focus(
    m: float, bright: int | None, pitch: float | None, fwhm: float | None, device: Device
) -> None:
    """plenoptic.md's table of the focused camera: reference values by another simulation."""
    camera = camera_of(device, m)
    image = camera.expose(MIDDLE).to_numpy().astype(np.float64)
    centres = camera.mla.centres()[15:46, 15:46]
    found = [spot(image, camera, place, m) for place in (centres * (1 + m)).reshape(-1, 2)]
    energy = np.array([one for one, _ in found]).reshape(31, 31)
    at = np.array([place for _, place in found]).reshape(31, 31, 2)
    row = energy[15]
    views = np.count_nonzero(row > 0.5 * row.max())
    least, most = sorted((abs(1 / m), abs((1 + camera.a / 0.24) / m)))
    assert least - 1 <= views <= most + 1
    assert camera.views == pytest.approx(abs((1 + camera.a / 0.24) / m))
    if bright is not None:
        assert views == bright
    if pitch is not None:
        weight = np.where(energy > 0.05 * energy.max(), energy, 0)
        for axis in (0, 1):
            measured = slope(weight, centres[..., axis], at[..., axis]) - 1
            assert measured == pytest.approx(pitch, rel=0.01), axis
        if abs(m) <= 0.3:
            assert measured == pytest.approx(m, rel=0.005 if m == 0.1 else 0.05)
    if fwhm is not None:
        assert width(image[900:930, 900:930].sum(0)) * 5 == pytest.approx(fwhm, abs=1.0)


@pytest.fixture(scope="module")
def strong(device: Device) -> Plenoptic2:
    """Lenslets of f/20, whose geometrical picture diffraction hardly moves."""
    return camera_of(device, 0.2, f=3e-3, count=84)


@pytest.mark.parametrize(
    ("place", "limit"),
    [((0.5e-3, 0.3e-3, 0), 0.1), ((-0.3e-3, 0.2e-3, 3e-3), 0.25)],
)
def test_spots_lie_where_the_ray_matrix_puts_them(
    place: Any, limit: float, strong: Plenoptic2
) -> None:
    """Under lenslets that are lit all over, the chief ray of each lenslet through the image.

    Out of focus a spot is wider, and uneven light on its lenslet moves it more.
    """
    image = strong.expose(PointSources(place)).to_numpy().astype(np.float64)
    matrix = strong.ray_matrix(place[2])
    alpha = strong.alpha(place[2])
    beta = strong.array_alpha(place[2])
    X = strong.on_array([place])[0, ::-1] / beta  # image of the point at F/alpha
    away = strong.array_distance - strong.image_distance / alpha
    lit = strong.aperture_diameter / 2 * abs(1 - beta)
    centres = strong.mla.centres().reshape(-1, 2)
    seen = np.hypot(*(np.abs(centres - X * beta) + PITCH / 2).T) < lit
    errors = []
    for c in centres[seen]:
        # from X with the slope that leads through the lenslet's centre
        expected = c + matrix[0] @ np.array([X - c, (c - X) / away])
        errors.append(spot(image, strong, expected, -matrix[0, 0])[1] - expected)
    assert len(errors) >= 9
    assert np.abs(errors).max() < limit * strong.pixel_pitch
