"""Maps, product and maps back against explicit float64 matrices, on the host and device routes."""

from __future__ import annotations

import gc
import math
import weakref
from functools import lru_cache

import numpy as np
import pytest
from fields import numpy_for_vkfft
from reference_lines import apply, unfolded
from tolerance import err_db, fft_tolerance, relative_max

from clplen.compute.device import Device
from clplen.compute.fft import columns, routes
from clplen.compute.fft.blocks import Spectrum, multiplied, run
from clplen.compute.fft.lines import (
    Line,
    Separable,
    chirp_z,
    convolution,
    cropped_inverse,
    identity,
    padded_spectrum,
)
from clplen.compute.fft.routes import FFTRoute
from clplen.errors import DeviceError

ROUTES = ["ducc0", "scipy", "device"]


@lru_cache
def with_route(device: Device, name: str, threads: int = 2) -> Device:
    """The same hardware with another FFT."""
    other = Device(device.cl_device, precision=device.precision)
    other.fft = FFTRoute("vkfft" if name == "device" else name, threads)
    return other


@pytest.fixture(params=ROUTES)
def on(request: pytest.FixtureRequest, device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    """The device with each route; "device": arrays stay on it."""
    if request.param == "ducc0":
        pytest.importorskip("ducc0")
    monkeypatch.setattr(routes, "_vkfft", numpy_for_vkfft)
    return with_route(device, request.param)


def random_complex(shape: int | tuple[int, ...], seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def placed(n: int, m: int, length: int, kind: str, seed: int) -> Line:
    """A line with everything a line may have, off the centre."""
    pre, post, kernel = (random_complex(k, seed + i) for i, k in enumerate((n, m, length)))
    kernel = kernel if kind == "convolve" else None
    offset, start = (length - n) // 3, length - m
    return Line(n, m, length, kind, offset=offset, start=start, pre=pre, kernel=kernel, post=post)


def bare(n: int, m: int) -> Line:
    """A line without factors before it, of the length that goes in."""
    return Line(n, m, n, "convolve", start=n - m, kernel=random_complex(n, n))


def tables(n: int, m: int, seed: int) -> dict[str, np.ndarray]:
    return {"pre": random_complex(n, seed), "post": random_complex(m, seed + 1)}


def tolerance(shape: tuple[int, int], device: Device, transforms: int = 2) -> float:
    """Of maps made of some transforms of windows up to a shape, one of them Bluestein's."""
    return transforms * fft_tolerance(shape, device.complex, bluestein=True)


MAPS = {  # name: (shape that goes in, maps)
    "pad": ((5, 8), Separable((padded_spectrum(5, 12),), (padded_spectrum(8, 15),))),
    "crop": ((12, 15), Separable((cropped_inverse(12, 7),), (cropped_inverse(15, 4),))),
    "convolve": (
        (5, 9),
        Separable(
            (convolution(5, 8, random_complex(13, 1)),), (convolution(9, 4, random_complex(14, 2)),)
        ),
    ),
    "chirps": (
        (11, 6),
        Separable(
            (chirp_z(11, 7, -math.sqrt(2) / 9, **tables(11, 7, 3)),),
            (chirp_z(6, 13, math.pi / 20, **tables(6, 13, 5)),),
        ),
    ),
    "off centre": (
        (6, 7),
        Separable((placed(6, 5, 13, "convolve", 7),), (placed(7, 9, 10, "inverse", 11),)),
    ),
    "one row": ((1, 9), Separable((identity(1),), (placed(9, 7, 11, "forward", 3),))),
    "one sample": ((1, 1), Separable((identity(1),), (identity(1),))),
    "x alone": ((7, 5), Separable(x=(placed(5, 8, 9, "forward", 4),))),
    "three along y, one along x": (
        (5, 6),
        Separable(
            (
                placed(5, 8, 8, "forward", 1),
                placed(8, 8, 8, "forward", 4),
                placed(8, 7, 9, "convolve", 8),
            ),
            (placed(6, 3, 10, "convolve", 9),),
        ),
    ),
    "a line that needs no window, between others": (
        (5, 6),
        Separable(
            (placed(5, 7, 8, "forward", 1), bare(7, 5), placed(5, 6, 9, "inverse", 8)),
            (padded_spectrum(6, 9), bare(9, 8), padded_spectrum(8, 11), bare(11, 11)),
        ),
    ),
}


def test_maps_alone(on: Device) -> None:
    for name, (shape, maps) in MAPS.items():
        for batch in ((2, 3), ()) if name == "chirps" else ((2,),):
            u = random_complex((*batch, *shape), 20).astype(on.complex)
            data = on.upload(u)
            (result,) = run(data, maps.astype(on.complex), [], [], on)
            expected = apply(u, maps.y, maps.x)
            got = on.download(result)
            assert got.dtype == on.complex
            many = 2 * max(len(maps.y) + len(maps.x), 1)
            assert relative_max(expected, got) <= tolerance(maps.widest(shape), on, many)
            np.testing.assert_array_equal(on.download(data), u)  # the input is untouched


def test_maps_in_double_precision(precise: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    for route in ["scipy", "device"]:
        monkeypatch.setattr(routes, "_vkfft", numpy_for_vkfft)
        for name in ["off centre", "chirps", "three along y, one along x"]:
            on, (shape, maps) = with_route(precise, route), MAPS[name]
            u = random_complex((2, *shape), 21)
            (result,) = run(on.upload(u), maps.astype(on.complex), [], [], on)
            assert relative_max(apply(u, maps.y, maps.x), on.download(result)) <= 1e-13


def test_no_map_at_all_gives_a_copy(on: Device) -> None:
    u = random_complex((2, 3, 4), 1).astype(on.complex)
    data = on.upload(u)
    (result,) = run(data, Separable((identity(3),), (identity(4),)), [], [], on)
    data.fill(0)
    np.testing.assert_array_equal(on.download(result), u)


def test_large_primes_round_like_other_lengths(on: Device) -> None:
    """2 101 and 2 127, one along each axis, in complex64.

    Through double the rounding of the input's, the middle's and the result's samples is left, each
    150 dB or less; transforms in single precision lose 132 to 137 dB.
    """
    u = random_complex((40, 50), 7).astype(np.complex64)
    for n, m in ((202, 254), (254, 202)):
        maps = Separable((padded_spectrum(40, n),), (padded_spectrum(50, m),))
        (result,) = run(on.upload(u), maps, [], [], on)
        assert err_db(apply(u, maps.y, maps.x), on.download(result)) > 140


SPECTRA = {  # name: (shape in, window of the spectrum, shape out)
    "even": ((5, 6), (12, 16), (5, 6)),
    "odd": ((5, 8), (11, 15), (5, 8)),
    "even and odd": ((4, 7), (8, 15), (6, 3)),
    "more columns and rows than a block": ((66, 67), (132, 135), (70, 130)),
    "one row": ((1, 6), (1, 14), (1, 9)),
    "one column": ((6, 1), (13, 1), (9, 1)),
    "one sample": ((1, 1), (1, 1), (1, 1)),
}


def there_and_back(name: str) -> tuple[Separable, Separable]:
    (ny, nx), (ly, lx), (my, mx) = SPECTRA[name]
    into = Separable((padded_spectrum(ny, ly),), (padded_spectrum(nx, lx),))
    return into, Separable((cropped_inverse(ly, my),), (cropped_inverse(lx, mx),))


def factors(shape: tuple[int, int], quadrant: bool, seed: int, device: Device) -> np.ndarray:
    """Random factors, asymmetric in y and x, whole or a quadrant."""
    if quadrant:
        shape = (shape[0] // 2 + 1, shape[1] // 2 + 1)
    return random_complex(shape, seed).astype(device.complex)


def check_spectra(
    on: Device, name: str, values: list[np.ndarray], batch: tuple[int, ...] = ()
) -> None:
    """`run` with these factors against matrices; the input stays as it was."""
    shape, middle, out = SPECTRA[name]
    into, back = there_and_back(name)
    u = random_complex((*batch, *shape), 30).astype(on.complex)
    data = on.upload(u)
    made = [Spectrum(on.upload(v), middle) for v in values]
    results = run(data, into, made, [back] * len(made), on)
    assert len(results) == len(values)
    for v, result in zip(values, results, strict=True):
        spectrum = apply(u, into.y, into.x) * unfolded(v.astype(complex), middle)
        expected = apply(spectrum, back.y, back.x)
        assert tuple(result.shape) == (*batch, *out)
        assert relative_max(expected, on.download(result)) <= tolerance(middle, on)
    np.testing.assert_array_equal(on.download(data), u)


def test_one_spectrum(on: Device) -> None:
    for name in SPECTRA:
        for quadrant in [True, False]:
            check_spectra(on, name, [factors(SPECTRA[name][1], quadrant, 1, on)], (2,))


def test_several_spectra_from_one_beginning(on: Device) -> None:
    for name in ["even", "one row"]:
        kinds = (True, False, True)
        values = [factors(SPECTRA[name][1], kind, i, on) for i, kind in enumerate(kinds)]
        check_spectra(on, name, values, (3,))


def test_each_spectrum_has_its_own_way_back(on: Device) -> None:
    into, back = there_and_back("odd")
    other = Separable(
        (bare(11, 9), placed(9, 5, 12, "forward", 2)), (placed(15, 8, 15, "convolve", 5),)
    )
    values = [factors((11, 15), True, i, on) for i in range(3)]
    u = random_complex((2, 5, 8), 30).astype(on.complex)
    made = [Spectrum(on.upload(v), (11, 15)) for v in values]
    ways = [other.astype(on.complex), back, other.astype(on.complex)]
    for v, way, result in zip(values, ways, run(on.upload(u), into, made, ways, on), strict=True):
        spectrum = apply(u, into.y, into.x) * unfolded(v.astype(complex), (11, 15))
        expected = apply(spectrum, way.y, way.x)
        assert relative_max(expected, on.download(result)) <= tolerance((12, 15), on, 4)


def test_columns_whose_factors_are_zero_are_not_read(device: Device) -> None:
    """What lies there is no number."""
    for dark in [[slice(3, 6)], [slice(0, 1), slice(6, None)], [slice(0, None)]]:
        for quadrant in [True, False]:
            on, shape = with_route(device, "scipy"), (12, 15)
            u = random_complex((2, 5, 9))
            into = Separable((padded_spectrum(5, 12),), (padded_spectrum(9, 15),))
            back = Separable((cropped_inverse(12, 7),), (cropped_inverse(15, 8),))
            H = random_complex((7, 8) if quadrant else shape, 3)
            lit = np.ones(H.shape[1], bool)
            for chosen in dark:
                H[:, chosen], lit[chosen] = 0, False
            expected = apply(apply(u, into.y, into.x) * unfolded(H, shape), back.y, back.x)
            whole = Spectrum.of(unfolded(H, shape), on)
            poisoned = np.where(lit, H, np.nan).T.astype(on.complex, order="C")
            made = Spectrum(on.upload(poisoned), shape, turned=True, lit=lit)
            data = on.upload(u.astype(on.complex))
            alone = run(data, into, [made], [back], on)
            for got in (*alone, *run(data, into, [whole, whole], [back, back], on)):
                if lit.any():
                    assert relative_max(expected, on.download(got)) <= tolerance(shape, on)
                else:
                    assert not on.download(got).any()


def test_spectra_of_the_host_know_their_zeros(on: Device) -> None:
    """As the route reads them: rows and columns of zeros, in the middle and at the end."""
    H = random_complex((5, 7))
    H[:, [0, 3]], H[2] = 0, 0
    made = Spectrum.of(H, on)
    read = on.download(made.values)
    np.testing.assert_array_equal(read.T if made.turned else read, H.astype(on.complex))
    assert made.turned == (on.fft.name != "vkfft")
    if made.turned:
        assert made.lit is not None
        assert made.lit.tolist() == [False, True, True, False, True, True, True]


def test_of_two_spectra_either_lights_a_column(device: Device) -> None:
    on, shape = with_route(device, "scipy"), (6, 8)
    u, H = random_complex((6, 8)), random_complex((2, 6, 8), 5)
    H[0][:, [1, 2, 6]], H[1][:, [2, 3]] = 0, 0
    into = Separable((padded_spectrum(6, 6),), (padded_spectrum(8, 8),))
    back = Separable((cropped_inverse(6, 6),), (cropped_inverse(8, 8),))
    made = [Spectrum.of(one, on) for one in H]
    for got, one in zip(
        run(on.upload(u.astype(on.complex)), into, made, [back, back], on), H, strict=True
    ):
        expected = apply(apply(u, into.y, into.x) * one, back.y, back.x)
        assert relative_max(expected, on.download(got)) <= tolerance(shape, on)


def test_factors_alone(on: Device) -> None:
    """No map before or after: the product itself, the input kept."""
    u = random_complex((2, 4, 5), 1).astype(on.complex)
    values = [random_complex((4, 5), i).astype(on.complex) for i in (2, 3)]
    data = on.upload(u)
    made = [Spectrum(on.upload(v), (4, 5)) for v in values]
    none = Separable()
    for v, result in zip(values, run(data, none, made, [none] * 2, on), strict=True):
        assert relative_max(u * v.astype(complex), on.download(result)) <= 1e-6  # one product
    np.testing.assert_array_equal(on.download(data), u)


def test_blocks_and_threads_change_nothing(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(columns, "MIN_BLOCK_LINES", 1)
    for name, threads, block_bytes in (
        # a line of 16 complex64 samples has 128 bytes: blocks of one line, of three, and of all
        ("odd", 2, 1),
        ("even and odd", 5, 400),
        ("even", 2, 2**19),
        ("one column", 5, 1),
    ):
        monkeypatch.setattr(columns, "BLOCK_BYTES", block_bytes)
        on, middle = with_route(device, "scipy", threads), SPECTRA[name][1]
        values = [factors(middle, quadrant, i, on) for i, quadrant in enumerate((True, False))]
        check_spectra(on, name, values, (2,))
        shape, maps = MAPS["three along y, one along x"]
        u = random_complex((3, *shape), 20).astype(on.complex)
        (result,) = run(on.upload(u), maps.astype(on.complex), [], [], on)
        expected = apply(u, maps.y, maps.x)
        limit = tolerance(maps.widest(shape), on, 8)
        assert relative_max(expected, on.download(result)) <= limit


def test_an_error_in_a_thread_is_raised(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise MemoryError("no room for a block")

    monkeypatch.setattr(columns, "_transform", fails)
    shape, maps = MAPS["pad"]
    on = with_route(device, "scipy")
    data = on.upload(random_complex(shape).astype(on.complex))
    with pytest.raises(DeviceError, match=r"needs more memory .*no room"):
        run(data, maps, [], [], on)


def test_dropped_spectra_free_their_memory_at_once(device: Device) -> None:
    """No reference cycle keeps a buffer until the garbage collector runs."""
    gc.disable()
    try:
        spectrum = Spectrum.of(random_complex((5, 7)), device)
        twin = spectrum.conjugate()
        alive = [weakref.ref(kept) for kept in (spectrum, twin)]
        del twin
        assert alive[1]() is None
        del spectrum
        assert alive[0]() is None
    finally:
        gc.enable()


def test_multiplied(device: Device) -> None:
    for shape, quadrant, copy in (
        ((6, 9), True, True),
        ((7, 4), False, False),
        ((1, 5), True, False),
    ):
        values = factors(shape, quadrant, 3, device)
        u = random_complex((2, *shape), 4).astype(device.complex)
        data = device.upload(u)
        out = device.download(
            multiplied(data, Spectrum(device.upload(values), shape).conjugate(), device, copy=copy)
        )
        expected = u * unfolded(values.astype(complex), shape).conj()
        assert relative_max(expected, out) <= 1e-6  # one product in float32
        np.testing.assert_array_equal(device.download(data), u if copy else out)
