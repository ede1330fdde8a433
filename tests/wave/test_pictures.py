"""Pictures on a field's samples and resampled by area."""

import numpy as np
import pytest

from clplen import Field, Grid, ShapeError
from clplen.wave.elements.transparency import transparency

LAM = 532e-9


def field(grid, device, seed=0):
    random = np.random.default_rng(seed)
    u = random.normal(size=grid.shape) + 1j * random.normal(size=grid.shape)
    return Field.from_array(u, grid, wavelength=LAM, device=device)


def ones(grid, device):
    return Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)


def test_on_the_samples_of_the_field(device, precise):
    for shape in [(7, 12), (13, 5)]:
        random = np.random.default_rng(4)
        amplitude, phase = random.uniform(0, 1, shape), random.uniform(-9, 9, shape)
        grid = Grid(shape, (2e-6, 3e-6))
        for where, tolerance in ((device, 4e-7), (precise, 1e-14)):  # rounding of one product
            light = field(grid, where)
            u = light.to_numpy()
            for kwargs, t in (
                ({"amplitude": amplitude}, amplitude),
                ({"phase": phase}, np.exp(1j * phase)),
                ({"amplitude": amplitude, "phase": phase}, amplitude * np.exp(1j * phase)),
                ({"amplitude": amplitude * 1j}, 1j * amplitude),
                ({"amplitude": amplitude > 0.5}, amplitude > 0.5),
            ):
                got = transparency(light, **kwargs).to_numpy()
                assert np.abs(got - u * t).max() <= tolerance * np.abs(u).max()


def fine_mean(grid, picture, pitch, centre, fine):
    """Mean over cells by midpoints of spacing ``fine``, exact where it divides all edges."""
    ny, nx = grid.shape
    counts = [round(d / fine) for d in grid.pitch]
    values = []
    for axis, (n, count) in enumerate(zip((ny, nx), counts, strict=True)):
        steps = np.arange(n * count) + 0.5
        at = grid.origin[axis] - (n // 2 + 0.5) * grid.pitch[axis] + steps * fine
        size = picture.shape[axis]
        values.append(np.floor((at - centre[axis]) / pitch[axis] + size // 2 + 0.5).astype(int))
    rows, columns = np.meshgrid(*values, indexing="ij")
    inside = (rows >= 0) & (rows < picture.shape[0]) & (columns >= 0)
    inside &= columns < picture.shape[1]
    dense = np.where(inside, picture[np.where(inside, rows, 0), np.where(inside, columns, 0)], 0)
    return dense.reshape(ny, counts[0], nx, counts[1]).mean(axis=(1, 3))


def test_area_weights(device, precise):
    for shape, pitch, origin in [
        ((11, 8), (2e-6, 3e-6), (0, 0)),
        ((4, 6), (14e-6, 4e-6), (3e-6, -2e-6)),
        ((31, 40), (1e-6, 1e-6), (-1e-6, 0.5e-6)),
    ]:
        for picture_shape in [(7, 6), (4, 9)]:
            random = np.random.default_rng(6)
            amplitude, phase = (
                random.uniform(0, 1, picture_shape),
                random.uniform(-3, 3, picture_shape),
            )
            grid = Grid(shape, pitch, origin=origin)
            spacing, centre = (3e-6, 5e-6), (1e-6, -2e-6)
            complex_t = amplitude * np.exp(1j * phase)
            expected = fine_mean(grid, complex_t, spacing, centre, 0.5e-6)
            assert np.abs(expected).max() > 0.1
            for where, tolerance in (
                (device, 2e-7),
                (precise, 1e-13),
            ):  # rounding of the transmission
                got = transparency(
                    ones(grid, where), amplitude, phase=phase, pitch=spacing, centre=centre
                )
                assert np.abs(got.to_numpy() - expected).max() <= tolerance


def test_an_axis_of_one_sample(precise):
    light = ones(Grid((1, 6), (9e-6, 2e-6)), precise)
    got = transparency(light, [[1.0, 3.0, 5.0]], pitch=4e-6, centre=(7e-6, -1e-6))
    np.testing.assert_allclose(got.to_numpy(), [[1, 1, 3, 3, 5, 5]], rtol=1e-14)
    with pytest.raises(ShapeError, match=r"a single pixel along axis 0, .* got 2 pixels"):
        transparency(light, np.ones((2, 3)), pitch=4e-6)


def test_bad_pictures(device):
    for change, error, message in [
        ({"amplitude": None}, ValueError, "an amplitude, a phase or both"),
        ({"amplitude": np.ones(5)}, ShapeError, r"shape \(ny, nx\), got \(5,\)"),
        ({"amplitude": np.ones((0, 5))}, ShapeError, r"got \(0, 5\)"),
        ({"amplitude": np.ones((6, 5))}, ShapeError, r"field's shape \(5, 6\), got \(6, 5\)"),
        ({"phase": np.ones((6, 5))}, ShapeError, r"amplitude, \(5, 6\), got \(6, 5\)"),
        ({"phase": 1j * np.ones((5, 6))}, ValueError, "phase must be real"),
        (
            {"amplitude": np.full((5, 6), np.nan)},
            ValueError,
            "amplitude must be finite, got 30 values",
        ),
        ({"phase": np.full((5, 6), np.inf)}, ValueError, "phase must be finite, got 30 values"),
        ({"centre": (1e-6, 0)}, ValueError, "requires a pitch"),
        ({"pitch": 0}, ValueError, "picture's pitch must be positive"),
        ({"pitch": (1e-6, np.nan)}, ValueError, "picture's pitch must be positive"),
        ({"pitch": 1e-6, "centre": (0, np.inf)}, ValueError, "centre of a picture must be finite"),
    ]:
        values = {"amplitude": np.ones((5, 6))} | change
        with pytest.raises(error, match=message):
            transparency(ones(Grid((5, 6), 1e-6), device), **values)
