"""Shapes of apertures against fine rasters, their areas and their soft edges."""

from __future__ import annotations

import numpy as np
import pytest
from reference_render import covered, raster
from scipy.special import i0

from clplen.errors import ShapeError
from clplen.lightfield.model.apertures import (
    annulus,
    disc,
    gaussian,
    half_plane,
    hann,
    kaiser,
    polygon,
    regular_polygon,
)
from clplen.lightfield.model.light_field import LightField

VIEWS, FINE = (7, 9), 200
V, U = raster(VIEWS, FINE)
# A raster of 200 misjudges at most the cells that the rim crosses, 2 in each of 200 lines.
RASTER = 2 / FINE


def judged(w: np.ndarray, inside: np.ndarray) -> None:
    assert w.dtype == np.float32
    assert np.abs(w - covered(np.broadcast_to(inside, (7 * FINE, 9 * FINE)), FINE)).max() <= RASTER


@pytest.mark.parametrize(("radius", "centre"), [((1.3, 3.1), None), (0.3, (2.2, 5.7))])
def test_discs_and_annuli(radius, centre):
    v, u = centre or (3, 4)
    high, wide = np.broadcast_to(radius, 2)
    r = np.hypot((V - v) / high, (U - u) / wide)
    judged(disc(VIEWS, radius, centre=centre), r <= 1)
    inner = (0.4 * high, 0.4 * wide)
    judged(annulus(VIEWS, inner, radius, centre=centre), (r <= 1) & (r >= 0.4))


def test_areas():
    """The sum is the area in cells, whatever lies between views."""
    assert disc(VIEWS, 2.3, centre=(3.1, 4.3)).sum() == pytest.approx(np.pi * 2.3**2, rel=1e-6)
    hexagon = regular_polygon(VIEWS, 6, 2.0, angle=0.3)
    assert hexagon.sum() == pytest.approx(1.5 * np.sqrt(3) * 4, rel=1e-6)
    assert half_plane(VIEWS, 0.4).sum() == pytest.approx(63 / 2, rel=1e-6)


def test_polygons():
    """A triangle, an arrow (not convex), either way round, beyond the views."""
    triangle = np.array([(0.3, 1.1), (5.6, 2.2), (2.1, 9.7)])
    sides = [
        (b[0] - a[0]) * (U - a[1]) - (b[1] - a[1]) * (V - a[0])
        for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True)
    ]
    inside = np.all([s >= 0 for s in np.broadcast_arrays(*sides)], axis=0)
    inside |= np.all([s <= 0 for s in np.broadcast_arrays(*sides)], axis=0)
    judged(polygon(VIEWS, triangle), inside)
    judged(polygon(VIEWS, triangle[::-1]), inside)
    arrow = [(1, 1), (5, 4), (1, 7), (2.5, 4)]
    # |u - 4| / 3 = t: between v = 2.5 - 1.5 t and v = 5 - 4 t
    t = abs(U - 4) / 3
    judged(polygon(VIEWS, arrow), (t <= 1) & (2.5 - 1.5 * t <= V) & (5 - 4 * t >= V))


def test_regular_polygons_turn_from_u_to_v():
    triangle = regular_polygon(VIEWS, 3, 3.0, angle=0.2, centre=(3.2, 4.1))
    normals = 0.2 + np.pi / 3 * np.array([1, 3, 5])  # of the sides, 3/2 from the middle
    inside = [(V - 3.2) * np.sin(t) + (U - 4.1) * np.cos(t) <= 1.5 for t in normals]
    judged(triangle, np.all(inside, axis=0))
    judged(regular_polygon(VIEWS, 4, (1.2, 3)), abs(V - 3) / 1.2 + abs(U - 4) / 3 <= 1)


def test_half_planes_keep_the_side_of_their_angle():
    judged(half_plane(VIEWS, 0), np.broadcast_arrays(U >= 4, V)[0])
    judged(
        half_plane(VIEWS, 0.7, centre=(2, 6)), (V - 2) * np.sin(0.7) + (U - 6) * np.cos(0.7) >= 0
    )


def test_apodisations():
    v, u = np.mgrid[:7, :9]
    r = np.hypot(v - 2.5, (u - 4) / 2)
    np.testing.assert_allclose(
        gaussian(VIEWS, (1.0, 2.0), centre=(2.5, 4)), np.exp(-(r**2) / 2), rtol=1e-6
    )
    r = np.hypot(v - 2.5, u - 4) / 3
    np.testing.assert_allclose(
        hann(VIEWS, 3, centre=(2.5, 4)), np.where(r < 1, np.cos(np.pi * r / 2) ** 2, 0), atol=1e-7
    )
    want = np.where(r <= 1, i0(5 * np.sqrt(np.maximum(1 - r**2, 0))) / i0(5), 0)
    np.testing.assert_allclose(kaiser(VIEWS, 3, 5, centre=(2.5, 4)), want, atol=1e-7)


def test_they_go_where_apertures_go(device):
    a = np.random.default_rng(1).uniform(1, 200, (*VIEWS, 3, 5)).astype(np.float32)
    lf = LightField.from_array(a, device=device)
    w = disc(lf.shape, 2.2, centre=(2.5, 4)) * hann(lf.shape, 4)
    want = np.tensordot(w.astype(float), a, 2) / w.sum(dtype=float)
    np.testing.assert_allclose(lf.render(aperture=w).to_numpy(), want, rtol=1e-5)


REFUSED = [
    (lambda: disc(VIEWS, 0), ValueError, "radius must be positive"),
    (lambda: disc(VIEWS, 1, centre=(40, 40)), ValueError, "disc covers no view"),
    (lambda: annulus(VIEWS, 2, 2), ValueError, "inner must be below outer"),
    (lambda: polygon(VIEWS, [(0, 0), (1, 1)]), ShapeError, "n >= 3"),
    (lambda: regular_polygon(VIEWS, 2, 1), ValueError, "integer of at least 3"),
    (lambda: half_plane(VIEWS, np.inf), ValueError, "finite, in radians"),
    (lambda: kaiser(VIEWS, 2, -1), ValueError, "from 0 to 100"),
    (lambda: disc((7,), 2), ShapeError, r"views must be \(V, U, \.\.\.\)"),
    (lambda: disc(VIEWS, 2, centre=3), ValueError, r"must be \(v, u\), got 3"),
]


def test_bad_shapes_are_refused():
    for make, error, words in REFUSED:
        with pytest.raises(error, match=words):
            make()


@pytest.mark.parametrize("centre", [(9.66, 38.18), (23.0, 23.0)])
def test_no_view_outside_a_shape_counts(centre: tuple[float, float]) -> None:
    v, u = np.indices((47, 47)) - np.array(centre)[:, None, None]
    far = np.hypot(v, u) > 8.7 + 0.71  # half a diagonal beyond the rim
    assert far.sum() > 500
    near = np.hypot(v, u) < 4.35 - 0.71
    assert not disc((47, 47), 8.7, centre=centre)[far].any()
    ring = annulus((47, 47), 4.35, 8.7, centre=centre)
    assert not ring[far].any()
    assert not ring[near].any()
