"""Lattices of lenslets: drawn white images whose lattice is known, real ones, and what is none."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from reference_lattice import lattice, white

from clplen.errors import FormatError
from clplen.lightfield.calibration import Lattice, estimate_lattice

PITCH = 1e-3  # relative
CLEAN, NOISY = 0.02, 0.2  # pixels rms, over all centres


def drawn(kind, pitch, degrees, *, stretch=1.0, **more):
    """(true lattice, white image) of at least sixteen lenslets across, sides unequal."""
    n = max(260, int(16 * pitch))
    true = lattice(kind, pitch, degrees=degrees, stretch=stretch, origin=(n / 2 + 0.3, n / 2))
    return true, white((n, n + 31), true, **more)


def off(true, found):
    return np.sqrt((true.off(found.centres()) ** 2).sum(axis=1).mean())


@pytest.mark.parametrize(
    ("kind", "pitch", "degrees", "more"),
    [
        ("rectangular", 5.3, 3, {}),
        ("rectangular", 9.3, -9, {"name": "gauss"}),
        ("rectangular", 14, 3, {"dim": "random"}),
        ("rectangular", 30.7, 0, {"stretch": 1.002}),
        ("hexagonal", 9.3, 3, {}),
        ("hexagonal", 14, -9, {"dim": "random"}),
        ("hexagonal", 30.7, 3, {"dim": "random"}),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_drawn_white_images(kind, pitch, degrees, more, noise):
    true, picture = drawn(kind, pitch, degrees, **more)
    picture = picture + np.random.default_rng(1).normal(0, 1, picture.shape) * noise
    found = estimate_lattice(picture)
    assert found.kind == kind
    assert np.hypot(*found.column) == pytest.approx(pitch, rel=PITCH)
    assert off(true, found) < (NOISY if noise else CLEAN)
    assert found.residual < 0.3


def test_a_stretched_lattice_is_no_square_one():
    _, picture = drawn("rectangular", 15, 0, stretch=1.01)
    found = estimate_lattice(picture)
    assert np.hypot(*found.row) / np.hypot(*found.column) == pytest.approx(1.01, rel=2e-4)


def test_the_sign_of_the_rotation():
    """Positive turns +x towards +y, which is down."""
    _, picture = drawn("rectangular", 14, 3)
    found = estimate_lattice(picture)
    assert np.degrees(found.rotation) == pytest.approx(3, abs=0.02)
    assert found.column[0] > 0  # along +x the row of lenslets sinks


def test_dark_frame():
    true, picture = drawn("rectangular", 14, 3)
    dark = 0.5 + np.mgrid[: picture.shape[0], : picture.shape[1]][1] / 100
    assert off(true, estimate_lattice(picture + dark, dark=dark)) < CLEAN


@pytest.mark.parametrize("what", ["blank", "noise", "texture", "photograph"])
def test_no_lattice_is_never_trusted(what):
    rng = np.random.default_rng(3)
    fy, fx = np.fft.fftfreq(300)[:, None], np.fft.fftfreq(300)
    radius = np.maximum(np.hypot(fy, fx), 1 / 300)
    texture = np.fft.ifft2(np.fft.fft2(rng.normal(size=(300, 300))) / radius).real
    picture = {
        "blank": np.full((300, 300), 7.0),
        "noise": rng.normal(size=(300, 300)),
        "texture": texture,
        "photograph": texture + 3 * (np.hypot(fy, fx) < 0.2) + (fx > 0.1),
    }[what]
    try:
        found = estimate_lattice(picture)
    except (FormatError, ValueError):
        return
    assert found.trust == "low"


def test_vesicle(data_folder):
    folder = data_folder / "lfm_guv"
    flat, dark = (
        tifffile.imread(folder / f"{name}_GUVExperim1.tif").astype(float)
        for name in ("Radiometry", "DarkFrame")
    )
    found = estimate_lattice(flat, dark=dark)
    assert found.kind == "rectangular"
    assert found.trust == "high"
    along_x, along_y = np.hypot(*found.column), np.hypot(*found.row)
    assert along_x == pytest.approx(15.387, rel=5e-4)
    assert along_y == pytest.approx(15.410, rel=5e-4)
    assert np.degrees(found.rotation) == pytest.approx(-0.12, abs=0.03)
    assert distance(found, (210.05, 224.64)) < 0.2


def test_beads(data_folder):
    found = estimate_lattice(tifffile.imread(data_folder / "lfm_beads" / "img_bg.tif"))
    assert np.hypot(*found.column) == pytest.approx(19.217, rel=5e-4)
    assert np.hypot(*found.row) == pytest.approx(19.217, rel=5e-4)
    assert distance(found, (608.60, 803.83)) < 0.5


def distance(found, point):
    """How far a point lies from the next centre of a lattice."""
    basis = np.array([found.row, found.column]).T
    steps = np.linalg.solve(basis, np.subtract(point, found.origin))
    return np.hypot(*(basis @ (steps - np.round(steps))))


def test_a_lattice_is_kept_as_json(tmp_path):
    _, picture = drawn("hexagonal", 14, 3)
    found = estimate_lattice(picture)
    found.save(tmp_path / "grid.json")
    again = Lattice.load(tmp_path / "grid.json")
    assert again == found
    np.testing.assert_array_equal(again.centres(), found.centres())


def test_json_that_is_none(tmp_path):
    (tmp_path / "grid.json").write_text("{")
    with pytest.raises(FormatError, match=r"grid\.json"):
        Lattice.load(tmp_path / "grid.json")
