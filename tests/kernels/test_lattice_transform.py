"""lattice_transform.cl: pictures to packed spectra and back, against NumPy's transforms."""

import math

import numpy as np
import pytest
from reference_spectra import PLANES, packed
from tolerance import relative_max

from clplen.compute.fft.lines import smooth_length
from clplen.microscopy.reconstruction.lattice_transform import LatticeTransform, radices_of

ALL, FIRST = 4, 1  # planes of a stack, and the first that is taken
STACK = (PLANES, FIRST, ALL)
# every radix, alone and after others, of either axis; a window that the lattice fills
WINDOWS = [(5, 6), (6, 9), (4, 4), (1, 1), (2, 7), (7, 2), (49, 8), (3, 25), (14, 15), (1, 27)]


def filled(window):
    """Lenslets of a lattice with zeros around, as a projection has them."""
    return tuple(-(-2 * k // 3) for k in window)


def pictures(w, shape, seed):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((2, ALL, shape[0] * w[0], shape[1] * w[1])).astype(np.float32)


def on_window(stacks, w, shape, window):
    """The samples of the planes taken, (frames, planes, w^2, ny, nx), float64."""
    rows, columns = shape
    cells = stacks[:, FIRST : FIRST + PLANES].reshape(2, PLANES, rows, w[0], columns, w[1])
    cells = cells.transpose(0, 1, 3, 5, 2, 4).reshape(2, PLANES, math.prod(w), rows, columns)
    out = np.zeros((2, PLANES, math.prod(w), *window))
    out[..., :rows, :columns] = cells
    return out


def packed_on(device, stacks, w, shape, window, parts):
    expected = packed(on_window(stacks, w, shape, window), w, parts)
    out = device.upload(np.full(expected.shape, np.nan, np.float32))
    transform = LatticeTransform(device, window)
    transform.run("spectra", out, device.upload(stacks), w, 2, STACK, shape, parts)
    return expected, out


def there_and_back(device, w, window, parts, shape, seed=0):
    stacks = pictures(w, shape, seed)
    expected, spectra = packed_on(device, stacks, w, shape, window, parts)
    # roundings of about log2(ny nx) sums each, and of a sum and a turn of the pairs
    assert relative_max(expected, device.download(spectra)) < 1e-6
    out = device.upload(np.full_like(stacks, 9))
    transform = LatticeTransform(device, window)
    transform.run("pictures", out, spectra, w, 2, STACK, shape, parts, -math.inf)
    again = device.download(out)
    taken = slice(FIRST, FIRST + PLANES)
    # every part gives the whole back: the transpose of an isometry, times their number
    assert relative_max(len(parts) * stacks[:, taken], again[:, taken]) < 1e-6
    assert (again[:, [0, 3]] == 9).all()


def test_windows(device):
    for number, window in enumerate(WINDOWS):
        there_and_back(device, ((3, 3), (5, 2))[number % 2], window, (0,), filled(window))


@pytest.mark.parametrize("parts", [(0, 2), (0, 1, 2, 3)])
def test_parts(device, parts):
    there_and_back(device, (2, 3), (6, 9), parts, (4, 6))


def test_more_fields_than_items_take_at_once(device):
    there_and_back(device, (15, 15), (6, 5), (0,), (5, 5))


def test_no_sample_is_below_the_least(device):
    w, window, shape = (3, 2), (5, 6), (4, 4)
    stacks = pictures(w, shape, 1)
    _, spectra = packed_on(device, stacks, w, shape, window, (0,))
    out = device.upload(np.full_like(stacks, 9))
    LatticeTransform(device, window).run("pictures", out, spectra, w, 2, STACK, shape, (0,), 0.0)
    got = device.download(out)[:, FIRST : FIRST + PLANES]
    assert got.min() == 0
    expected = np.maximum(stacks[:, FIRST : FIRST + PLANES], 0)
    assert np.abs(got - expected).max() < 1e-6 * np.abs(stacks).max()


def test_radices_of_every_smooth_length():
    for n in {smooth_length(n) for n in range(1, 500)}:
        *radices, end = radices_of(n)
        assert math.prod(radices) == n
        assert end == 0
        assert set(radices) <= {2, 3, 4, 5, 7} or n == 1
