"""The slanted edge: known Gaussians and known pixels at several angles, both ways round."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import erf

from clplen.analysis.point.edge import slanted_edge
from clplen.analysis.point.otf import pixel_mtf
from clplen.errors import ShapeError
from clplen.wave.elements.hard_apertures import polygon_coverage
from clplen.wave.field.field import Grid

PITCH = 2e-6
OFFSET = 3.3e-6  # of the edge from the middle, along the axis it crosses


def distance(grid: Grid, axis: int, degrees: float) -> np.ndarray:
    """From an edge across ``axis``, turned towards it from the other one; grows along it."""
    y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
    across, along = (x, y) if axis == 1 else (y, x)
    angle = math.radians(degrees)
    return (across - OFFSET) * math.cos(angle) - along * math.sin(angle)


def area(grid: Grid, axis: int, degrees: float) -> np.ndarray:
    """Exact part of every pixel behind the edge."""
    angle, far = math.radians(degrees), 50 * max(grid.extent)
    along = np.array((math.sin(angle), math.cos(angle)))  # (across, along)
    normal = np.array((math.cos(angle), -math.sin(angle)))
    start = np.array((OFFSET, 0.0))
    corners = [start - far * along, start + far * along]
    corners += [corners[1] + far * normal, corners[0] + far * normal]
    vertices = np.array(corners)
    return polygon_coverage(grid, vertices if axis == 0 else vertices[:, ::-1])


def found(grid: Grid, picture: np.ndarray, axis: int, degrees: float, expected) -> float:
    """Largest deviation up to .8 of the Nyquist frequency, after the checks of the edge."""
    edge = slanted_edge(picture, pitch=grid.pitch)
    assert edge.axis == axis
    assert math.degrees(edge.angle) == pytest.approx(degrees, abs=2e-3)
    assert edge.residual < 1e-3 * grid.pitch[axis]
    kept = edge.mtf.frequency <= 0.8 * 0.5 / grid.pitch[axis]
    assert kept.sum() > 50
    return float(np.abs(edge.mtf.value - expected(edge.mtf.frequency))[kept].max())


CASES = [((1.2 * PITCH, PITCH), 0, -5), ((PITCH, 1.2 * PITCH), 1, 11)]


@pytest.mark.parametrize(("pitch", "axis", "degrees"), CASES)
def test_a_gaussian_edge(pitch: tuple[float, float], axis: int, degrees: float) -> None:
    grid, sigma = Grid((97, 80), pitch), 1.5e-6
    away = distance(grid, axis, degrees)
    bright = 0.1 + 0.7 * (1 + erf(away / (2**0.5 * sigma))) / 2

    def expected(f: np.ndarray) -> np.ndarray:
        return np.exp(-2 * (np.pi * sigma * f) ** 2)

    assert found(grid, bright, axis, degrees, expected) < 0.0005  # it falls to .17
    assert found(grid, 1 - bright, axis, degrees, expected) < 0.0005


@pytest.mark.parametrize(("pitch", "axis", "degrees"), CASES)
def test_a_sharp_edge_on_pixels(pitch: tuple[float, float], axis: int, degrees: float) -> None:
    # A pixel's transfer function along the normal n: sinc(f n_y dy) sinc(f n_x dx).
    grid, angle = Grid((80, 97), pitch), math.radians(degrees)

    def expected(f: np.ndarray) -> np.ndarray:
        across = pixel_mtf(f * math.cos(angle), width=pitch[axis])
        return across * pixel_mtf(f * abs(math.sin(angle)), width=pitch[1 - axis])

    assert found(grid, area(grid, axis, degrees), axis, degrees, expected) < 0.001


def test_the_edge_spread_function_is_that_of_the_picture() -> None:
    grid, sigma = Grid((61, 70), PITCH), 2.5e-6
    picture = 3 + 2 * erf(-distance(grid, 1, -7) / (2**0.5 * sigma))
    edge = slanted_edge(picture, pitch=PITCH)
    expected = 3 + 2 * erf(-edge.distance / (2**0.5 * sigma))
    np.testing.assert_allclose(edge.spread, expected, atol=4e-3)
    step = PITCH / 4 * math.cos(math.radians(7))
    np.testing.assert_allclose(np.diff(edge.distance), step, rtol=1e-6)


def test_noise_moves_it_little() -> None:
    grid, sigma = Grid((120, 100), PITCH), 1.5e-6
    noise = np.random.default_rng(5).normal(0, 0.01, grid.shape)
    picture = (1 + erf(distance(grid, 1, 5) / (2**0.5 * sigma))) / 2 + noise
    edge = slanted_edge(picture, pitch=PITCH)
    assert math.degrees(edge.angle) == pytest.approx(5, abs=0.05)
    mtf50 = math.sqrt(math.log(2) / 2) / (math.pi * sigma)
    assert edge.mtf.at(0.5) == pytest.approx(mtf50, rel=0.03)


def test_bad_pictures_are_told() -> None:
    def edge(degrees: float, shape: tuple[int, int] = (97, 80)) -> np.ndarray:
        return area(Grid(shape, PITCH), 1, degrees)

    broken = np.where(np.arange(97)[:, None] < 40, edge(5), 1 - edge(5))
    for picture, error, words in (
        (edge(0.5), ValueError, r"1\.5 to 14\.0 degrees"),
        (edge(-17), ValueError, r"1\.5 to 14\.0 degrees"),
        (edge(math.degrees(math.atan(0.2))), ValueError, "nearly a simple fraction"),
        (edge(2.9, (19, 80)), ShapeError, "at least 20 lines"),
        (edge(5)[:, 30:], ShapeError, "on both sides"),
        (np.full((97, 80), 0.7), ValueError, "no edge"),
        (broken, ValueError, "cross every line"),
        (edge(5)[:17], ShapeError, "at least 18 samples"),
    ):
        with pytest.raises(error, match=words):
            slanted_edge(picture, pitch=PITCH)


def test_what_lies_far_from_the_edge_is_windowed_out() -> None:
    # A second step of 5 % at 95 % of the reach counts for .0245 of itself: Tukey's cosine there.
    grid, sigma = Grid((97, 80), PITCH), 1.5e-6
    away = distance(grid, 1, 5)
    reach = 39 * PITCH - OFFSET - 48 * PITCH * math.tan(math.radians(5))
    sharp = (1 + erf(away / (2**0.5 * sigma))) / 2
    edge = slanted_edge(sharp - 0.05 * (away < -0.95 * reach), pitch=PITCH)
    kept = edge.mtf.frequency < 0.4 / PITCH
    expected = np.exp(-2 * (np.pi * sigma * edge.mtf.frequency) ** 2)
    assert np.abs(edge.mtf.value - expected)[kept].max() < 0.006
