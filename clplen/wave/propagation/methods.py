"""From a request to the description of its method: the choice of ``auto`` and the exact methods.

as, blas and cblas by FFT, cblas by chirp-z transform, rs by its sampled kernel; fresnel.py has the
paraxial methods.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from clplen import units
from clplen.compute.fft.lines import (
    Line,
    Separable,
    chirp_z,
    cropped_inverse,
    identity,
    padded_spectrum,
    smooth_length,
)
from clplen.compute.fft.routes import has_large_prime
from clplen.errors import SamplingError, argument
from clplen.wave.field.transmission import phasor
from clplen.wave.propagation import fresnel, one_step
from clplen.wave.propagation.band import (
    EVANESCENT_REACH,
    ROUNDING,
    AxisSpan,
    Band,
    blas_limit,
    fully_sampled_distance,
    kernel_sampled_distance,
    whole_band,
)
from clplen.wave.propagation.description import (
    ANY_DISTANCE,
    Description,
    Request,
    flops,
    outshines,
    padded_length,
)
from clplen.wave.propagation.transfer_function import Sommerfeld, Transfer, fft_frequencies
from clplen.wave.propagation.windowed_kernel import WindowedKernel, kernel_axis, kernel_length

FFT_WINDOW = 2.5  # times the grid, up to which the FFT route is the cheaper one
LATTICE_SLACK = 1e-9  # of a frequency step
MOST_FREQUENCIES = 10**6  # along an axis
STARTING = 5e6  # operations in the time that it takes to start a map of both axes
SHORT = 512  # samples of a transform, below which fewer samples save little
FEWEST = 64  # frequencies of a band with hard edges
NEAR_WINDOW = 2.2  # times the grid, up to which FFTs of the window beat everything else
SAMPLED_KERNEL = 0.8  # of the Nyquist frequency, up to which the RS kernel is accurate
DECAYED = 18.4  # nepers that evanescent waves of the Nyquist frequency lose: 160 dB
FAINT = 4.0  # the same, from which the sum over samples is nearer to the light than a cut band
MOST_KERNEL_SAMPLES = 2**24  # of a windowed kernel, a few seconds of a CPU,
KERNEL_SHARE = 64  # or so many times the samples of a window that holds both grids
KERNEL_BYTES = 24  # a sample at the peak, in complex64: kernel, transform, tables
KERNEL_SECONDS, LINE_SECONDS = 2e-7, 1e-6  # a sample, and one of its axes, on two cores
SMOOTH_KERNEL = 3  # samples of z from which the kernel's peak is sampled to 160 dB: exp(-2 pi z/dx)

MOVED = "the output has another pitch or centre"
GRAZING = "waves that graze the plane leave every window"


def describe(r: Request) -> Description:
    """How a request is done: everything but the device."""
    if r.z == 0 and r.target == r.grid and r.method != "fresnel-1fft":
        return _identity(r)
    return automatic(r) if r.method == "auto" else _METHODS[r.method](r)


def automatic(r: Request) -> Description:
    """The cheapest of the methods that are exact at this distance; never a paraxial one."""
    bands = r.bands
    spans = [r.span(axis) for axis in r.axes]
    near = abs(r.z) < SMOOTH_KERNEL * max((span.pitch for span in spans), default=0.0)
    if not r.is_aligned:
        if not near and _leaves_every_window(r, bands):
            return _windowed_kernel(r, f"{MOVED}, and {GRAZING}")
        return _in_one_step(r, bands) or corrected(r, MOVED, "chirp-z")
    lengths = fft_lengths(r, bands)
    wide = max((lengths[axis] / r.grid.shape[axis] for axis in r.axes), default=1.0)
    share = max((span.geometric(span.reach) / span.nyquist for span in spans), default=0.0)
    sampled_kernel = bool(spans) and not near and all(_has_sampled_kernel(one) for one in spans)
    kernel = sampled_kernel and r.target.shape == r.grid.shape
    if any(span.is_evanescent for span in spans) and near:
        return _evanescent(r)
    if not kernel and not near and any(bands[axis].grazing for axis in r.axes):
        return _windowed_kernel(r, GRAZING)
    sampled = f"f_geo = {share:.3g} f_nyq"
    if all(bands[axis].is_whole for axis in r.axes) and (wide <= NEAR_WINDOW or not kernel):
        return _whole_band(
            r, f"f_geo + guard >= f_nyq ({sampled}): every sampled frequency arrives"
        )
    if wide <= NEAR_WINDOW or (wide <= FFT_WINDOW and not kernel):
        limit = NEAR_WINDOW if wide <= NEAR_WINDOW else FFT_WINDOW
        return corrected(r, f"W = {wide:.3g} S <= {limit} S", "fft")
    if kernel:
        return _far(
            r, f"W = {wide:.3g} S > {NEAR_WINDOW} S and {sampled} <= {SAMPLED_KERNEL} f_nyq"
        )
    return corrected(r, f"W = {wide:.3g} S > {FFT_WINDOW} S", "chirp-z")


def _in_one_step(r: Request, bands: list[Band]) -> Description | None:
    """The sum in one step where it is exact enough and less work than that over the band."""
    used = [bands[axis] for axis in r.axes]
    if r.z == 0 or r.guard == 0 or not used or any(any(b.clipped) or b.is_empty for b in used):
        return None
    series = one_step.best_series(r)
    if series.bound[1] > one_step.TOLERANCE:
        return None
    counts = [1 if n == 1 else _count(b) for n, b in zip(r.grid.shape, bands, strict=True)]
    made, over_band = _one_step(r, series, MOVED), _band_flops(r, bands, counts)
    if flops(made) + STARTING * (len(made.terms) - 1) >= over_band:
        return None
    share = f"{100 * flops(made) / over_band:.2g} % of the work of"
    return replace(made, why=f"{MOVED}; {share} {counts[0]} x {counts[1]} frequencies")


def _band_flops(r: Request, bands: list[Band], counts: list[int]) -> float:
    """`flops` of `by_chirps` with so many frequencies along (y, x), before a plan is made."""
    (ny, _), (my, mx) = r.grid.shape, r.target.shape

    def chirp(n: int, m: int) -> float:
        length = smooth_length(n + m - 1)
        return 0.0 if n == m == 1 else 10 * length * math.log2(length)

    def into(axis: int) -> float:
        n, length = r.grid.shape[axis], _padded_into(r, axis, bands[axis])
        return 5 * length * math.log2(length) if length and n > 1 else chirp(n, counts[axis])

    along_y = counts[1] * (into(0) + chirp(counts[0], my))
    return ny * into(1) + along_y + my * chirp(counts[1], mx)


def rayleigh_sommerfeld_in_one_step(r: Request) -> Description:
    """The sum over samples by a chirp-z transform between chirps, and a series for the rest."""
    if r.z == 0:
        raise SamplingError(
            f"one-step is for a distance z other than 0: use {argument('method', 'auto')} to "
            "sample a field anew."
        )
    return _one_step(r, one_step.best_series(r), "asked for")


def _one_step(r: Request, series: one_step.Series, why: str) -> Description:
    ways = series.ways()
    empty = Separable()
    terms = [(way, empty) if series.inward else (empty, way) for way in ways]
    step, nearest, warning = _kernel_sampling(r)
    automatic = r.method == "auto"
    if not automatic:
        nearest = max(nearest, one_step.nearest(r))
    if series.bound[1] > one_step.TOLERANCE:
        refused = series.bound[1] > one_step.MOST_ERROR
        wrong = "does not converge" if refused else "is not exact"
        warning = (
            f"The path between the grids {wrong} in one-step at z = {r.z:g} m: from "
            f"{nearest:.4g} m on the error is below 1e-9 of the field. Use "
            f"{argument('method', 'auto')} or {argument('method', 'cblas')}."
        )
    return Description(
        request=r,
        method="one-step",
        why=why,
        into=terms[0][0],
        back=terms[0][1],
        factor=one_step.SeriesFactor(series),
        kind="series",
        route=f"{len(terms)} chirp-z transforms of {' x '.join(map(str, ways[0].widest((1, 1))))}",
        sampled="kernel",
        phase_step=step,
        valid=(0.0 if automatic else nearest, math.inf),
        warning="" if automatic else warning,
        is_refused=series.bound[1] > one_step.MOST_ERROR,
        terms=tuple(terms),
    )


def _has_sampled_kernel(span: AxisSpan, nepers: float = DECAYED) -> bool:
    """Whether the samples of the kernel stand for it: no wave beyond the Nyquist frequency arrives.

    Because no ray that is wanted is so steep, or because such waves are evanescent and have lost
    so much.
    """
    if span.geometric(span.reach) <= SAMPLED_KERNEL * span.nyquist:
        return True
    beyond = (span.wavelength * span.nyquist) ** 2 - 1
    turns = abs(span.z) / span.wavelength
    return beyond > 0 and 2 * math.pi * turns * math.sqrt(beyond) >= nepers


def _leaves_every_window(r: Request, bands: list[Band]) -> bool:
    """Whether waves of the band graze the plane, along an axis or across both."""
    return any(bands[axis].grazing for axis in r.axes) or (
        sum((r.wavelength * max(abs(bands[a].low), abs(bands[a].high))) ** 2 for a in r.axes) >= 1
    )


def _far(r: Request, why: str) -> Description:
    """The sampled kernel, or the few frequencies that are left where they are less work."""
    kernel = sommerfeld(r, why)
    few = corrected(r, why, "chirp-z")
    if flops(few) >= flops(kernel):
        return kernel
    count = " x ".join(str(n) for n in few.into.shape_after(r.grid.shape))
    return replace(few, why=f"{why}; {count} frequencies, {_work_share(few, kernel)} of its work")


def _work_share(description: Description, other: Description) -> str:
    return f"{100 * flops(description) / flops(other):.0f} %"


def _evanescent(r: Request) -> Description:
    """The angular spectrum with its evanescent waves, in a window that holds both grids."""
    lengths = [
        n if n == 1 else max(length, smooth_length(n + max(n, m)))
        for n, m, length in zip(r.grid.shape, r.target.shape, fft_lengths(r, r.bands), strict=True)
    ]
    bands = [whole_band(r.span(axis)) for axis in (0, 1)]
    why = f"abs(z) = {abs(r.z):.3g} m <= {EVANESCENT_REACH} lam: evanescent waves count"
    valid = (0.0, EVANESCENT_REACH * r.wavelength)
    return by_fft(r, lengths, bands, method="as", why=why, valid=valid)


def _whole_band(r: Request, why: str) -> Description:
    """The angular spectrum in a window that holds its steepest rays, at least twice the grid."""
    bands = [whole_band(r.span(axis)) for axis in (0, 1)]
    needed = fft_lengths(r, r.bands)
    lengths = [
        n if n == 1 else max(length, smooth_length(2 * n))
        for n, length in zip(r.grid.shape, needed, strict=True)
    ]
    return by_fft(r, lengths, bands, method="as", why=why)


def _identity(r: Request) -> Description:
    method = "as" if r.method == "auto" else r.method
    return Description(r, method, "nothing", "none", Separable(), why="z = 0: the field itself")


def angular_spectrum(r: Request, why: str = "asked for") -> Description:
    """H over everything that is sampled (Goodman 2005, eq. 3-66), window ``pad`` times the grid."""
    lengths = [padded_length(n, r.pad) for n in r.grid.shape]
    reach = min(
        fully_sampled_distance(n, d, r.wavelength)
        for n, d in zip(lengths, r.grid.pitch, strict=True)
    )
    periodic = r.pad == 1
    warning = ""
    if abs(r.z) > reach and not periodic:
        grazing = any(r.wavelength * r.span(axis).nyquist >= 1 for axis in r.axes)
        wider = "" if grazing else ", or a larger pad"
        warning = (
            f"The transfer function at z = {r.z:g} m is aliased: it is sampled over the whole band "
            f"only up to {reach:.4g} m. Use {argument('method', 'auto')} or 'blas'{wider}."
        )
    bands = [whole_band(r.span(axis)) for axis in (0, 1)]
    valid = (0.0, math.inf if periodic else reach)
    return by_fft(r, lengths, bands, method="as", why=why, valid=valid, warning=warning)


def band_limited(r: Request) -> Description:
    """H over the band that the window samples (Matsushima and Shimobaba 2009, eq. 13)."""
    lengths = [padded_length(n, r.pad) for n in r.grid.shape]
    bands = []
    for axis, length in enumerate(lengths):
        span = r.span(axis)
        limit = blas_limit(length, span.pitch, r.z, r.wavelength)
        inside = min(limit, span.nyquist)
        cut = (inside == span.nyquist,) * 2
        bands.append(Band(-inside, inside, (-inside, inside), cut, math.inf, 0.0, span.nyquist))
    return by_fft(r, lengths, bands, method="blas", why="asked for")


def corrected(r: Request, why: str = "asked for", route: str = "") -> Description:
    """H over the guarded band, the window wide enough for its aliases to miss the output.

    ``route`` "fft" or "chirp-z"; by default the FFT where the grid allows it and the window is not
    much wider than the grid. With guard = 0 the band ends sharply where geometry says (figure 2.7
    of the thesis) and the window of the FFT route is that of ``pad``.
    """
    bands = r.bands
    empty = [axis for axis in r.axes if bands[axis].is_empty]
    warning = _no_light(r, bands[empty[0]], "yx"[empty[0]]) if empty else ""
    if r.method == "cblas" and not warning and any(bands[axis].grazing for axis in r.axes):
        warning = _grazing(r)
    lengths = fft_lengths(r, bands)
    near = all(bands[a].is_whole or lengths[a] <= FFT_WINDOW * r.grid.shape[a] for a in r.axes)
    if route == "fft" or (route == "" and r.is_aligned and near and not empty):
        return by_fft(r, lengths, bands, method="cblas", why=why, warning=warning)
    return by_chirps(r, bands, why=why, warning=warning)


def fft_lengths(r: Request, bands: list[Band]) -> list[int]:
    """Window lengths of the FFT route: the bands' windows, at least the two grids."""
    lengths = []
    for n, m, d, band in zip(r.grid.shape, r.target.shape, r.grid.pitch, bands, strict=True):
        if r.guard == 0:
            lengths.append(n if n == 1 else max(padded_length(n, r.pad), n + m if m > n else 0))
        else:
            lengths.append(n if n == 1 else smooth_length(max(n, m, math.ceil(band.window / d))))
    return lengths


def by_fft(
    r: Request,
    lengths: list[int],
    bands: list[Band],
    *,
    method: str,
    why: str,
    valid: tuple[float, float] = ANY_DISTANCE,
    warning: str = "",
) -> Description:
    """Pad, transform, multiply by H in each axis' band, transform back, cut."""
    into = [padded_spectrum(n, L) for n, L in zip(r.grid.shape, lengths, strict=True)]
    back = [cropped_inverse(L, m) for L, m in zip(lengths, r.target.shape, strict=True)]
    frequencies = [fft_frequencies(L, d) for L, d in zip(lengths, r.grid.pitch, strict=True)]
    weights = [
        np.ones(f.size) if L == 1 else band.weights(f)
        for f, L, band in zip(frequencies, lengths, bands, strict=True)
    ]
    factor = _transfer(r, (lengths[0], lengths[1]), frequencies, weights)
    steps = [
        abs(r.span(a).displacement(factor.highest()[a])) / (lengths[a] * r.grid.pitch[a] / 2)
        for a in r.axes
    ]
    return Description(
        request=r,
        method=method,
        why=why,
        into=Separable.of(into),
        back=Separable.of(back),
        factor=factor,
        kind="fft",
        route=f"FFT of {lengths[0]} x {lengths[1]} samples",
        sampled="transfer function",
        phase_step=max(steps, default=0.0),
        valid=valid,
        used=_used(bands, r),
        warning=warning,
    )


def by_chirps(r: Request, bands: list[Band], *, why: str, warning: str = "") -> Description:
    """The same sum over the band's own frequencies, in and out by chirp-z transforms."""
    into, back, frequencies, weights = [], [], [], []
    _require_few(r, bands)
    for axis, band in enumerate(bands):
        if r.grid.shape[axis] == 1:
            into.append(identity(1))
            back.append(identity(1))
            frequencies.append(np.zeros(1))
            weights.append(np.ones(1))
            continue
        band = _finer(band)
        length = _padded_into(r, axis, band)
        if length:
            band = replace(band, window=length * r.grid.pitch[axis])
        bands[axis] = band
        index = _lattice(band)
        f = index / band.window
        inside = np.zeros(1) if band.is_empty else band.weights(f) * _halved(f, band)
        frequencies.append(f)
        weights.append(inside)
        into.append(
            _padded_to_frequencies(r, axis, index, length)
            if length
            else _to_frequencies(r, axis, f, band.window)
        )
        offset = r.target.origin[axis] - r.grid.origin[axis]
        back.append(_from_frequencies(r, axis, f, band.window, offset))
    shape = (frequencies[0].size, frequencies[1].size)
    steps = [
        abs(r.span(a).displacement(np.abs(frequencies[a]).max())) / (bands[a].window / 2)
        for a in r.axes
    ]
    return Description(
        request=r,
        method="cblas",
        why=why,
        into=Separable.of(into),
        back=Separable.of(back),
        factor=_transfer(r, shape, frequencies, weights),
        kind="chirp-z",
        route=f"chirp-z transforms over {shape[0]} x {shape[1]} frequencies",
        sampled="transfer function",
        phase_step=max(steps, default=0.0),
        used=_used(bands, r),
        warning=warning,
    )


def _require_few(r: Request, bands: list[Band]) -> None:
    """Refuse more frequencies than any device holds a square of."""
    most = max((_count(bands[axis]) for axis in r.axes), default=1)
    if most > MOST_FREQUENCIES:
        raise SamplingError(
            f"cblas onto {r.target} would take {most:,} frequencies along an axis, at most "
            f"{MOST_FREQUENCIES:,} are done: use a smaller output window, a smaller support, or "
            f"{argument('method', 'one-step')} far away."
        )


def sommerfeld(r: Request, why: str = "asked for") -> Description:
    """Convolution with the sampled Rayleigh-Sommerfeld I kernel, windows of twice the grid.

    Onto another grid by its spectrum in a smooth window.
    """
    if not r.is_aligned or r.target.shape != r.grid.shape:
        return _windowed_kernel(r, why)
    lengths = [n if n == 1 else smooth_length(2 * n) for n in r.grid.shape]
    into = [padded_spectrum(n, L) for n, L in zip(r.grid.shape, lengths, strict=True)]
    back = [cropped_inverse(L, n) for n, L in zip(r.grid.shape, lengths, strict=True)]
    step, nearest, warning = _kernel_sampling(r)
    return Description(
        request=r,
        method="rs",
        why=why,
        into=Separable.of(into),
        back=Separable.of(back),
        factor=Sommerfeld((lengths[0], lengths[1]), r.grid.pitch, r.z, r.wavelength),
        kind="fft",
        route=f"FFT of {lengths[0]} x {lengths[1]} samples",
        sampled="kernel",
        phase_step=step,
        valid=(nearest, math.inf),
        warning=warning,
        is_refused=outshines(r),
    )


def _kernel_sampling(r: Request) -> tuple[float, float, str]:
    """Largest phase step of the kernel over pi, where it begins to be sampled, a warning."""
    spans = [r.span(axis) for axis in r.axes]
    step = max((span.geometric(span.reach) / span.nyquist for span in spans), default=0.0)
    nearest = max((kernel_sampled_distance(span) for span in spans), default=0.0)
    if abs(r.z) >= nearest:
        return step, nearest, ""
    warning = (
        f"The Rayleigh-Sommerfeld kernel at z = {r.z:g} m is aliased: it is sampled from "
        f"{nearest:.4g} m on. Use {argument('method', 'auto')} or {argument('method', 'cblas')}."
    )
    return step, nearest, warning


def _windowed_kernel(r: Request, why: str) -> Description:
    """The kernel in a smooth window, its spectrum between chirp-z transforms.

    The sum over the input's samples where waves beyond their Nyquist frequency do not arrive, else
    over the frequencies up to it.
    """
    if r.z == 0:
        return corrected(r, why, "chirp-z")
    axes, into, back = [], [], []
    _require_small_kernel(r)
    for axis, n in enumerate(r.grid.shape):
        span = r.span(axis)
        made = kernel_axis(span, math.inf if _has_sampled_kernel(span, FAINT) else span.nyquist)
        axes.append(made)
        if n == 1:
            into.append(identity(1))
            back.append(identity(1))
            continue
        into.append(_to_frequencies(r, axis, made.frequencies, made.width))
        back.append(_from_frequencies(r, axis, made.frequencies, made.width, 0.0))
    factor = WindowedKernel((axes[0], axes[1]), r.z, r.wavelength)
    step, nearest, warning = _kernel_sampling(r)
    automatic = r.method == "auto"
    band = [(float(one.frequencies[0]), float(one.frequencies[-1])) for one in axes]
    return Description(
        request=r,
        method="rs",
        why=why,
        into=Separable.of(into),
        back=Separable.of(back),
        factor=factor,
        kind="chirp-z",
        route=f"chirp-z transforms over {factor.shape[0]} x {factor.shape[1]} frequencies",
        sampled="kernel",
        phase_step=step,
        valid=(0.0 if automatic else nearest, math.inf),
        used=(band[0], band[1]),
        warning="" if automatic else warning,
    )


def _require_small_kernel(r: Request) -> None:
    """Refuse a kernel that is asked for so near that it has far more samples than the grids."""
    lengths = [kernel_length(r.span(axis)) for axis in (0, 1)]
    both = math.prod(n + m for n, m in zip(r.grid.shape, r.target.shape, strict=True))
    count = math.prod(lengths)
    most = max(MOST_KERNEL_SAMPLES, KERNEL_SHARE * both)
    if r.method == "rs" and (count > most or max(lengths) > MOST_FREQUENCIES):
        seconds = KERNEL_SECONDS * count + LINE_SECONDS * sum(lengths)
        raise SamplingError(
            f"rs onto another grid at z = {r.z:g} m would take a kernel of {lengths[0]:.3g} x "
            f"{lengths[1]:.3g} samples, {units.amount(KERNEL_BYTES * count, 'B')} in "
            f"complex64 and about {seconds:.2g} s: use {argument('method', 'auto')}."
        )


def _finer(band: Band) -> Band:
    """The band in a window that puts some frequencies inside, however narrow a hard edge is."""
    if band.guard > 0 or band.is_empty:
        return band
    return replace(band, window=max(band.window, FEWEST / (band.high - band.low)))


def _grazing(r: Request) -> str:
    return (
        f"Waves that graze the plane leave the window of cblas at z = {r.z:g} m and come back as "
        f"aliases: use {argument('method', 'auto')} or 'rs', or samples of more than "
        "half a wavelength."
    )


def _no_light(r: Request, band: Band, axis: str) -> str:
    return (
        f"No light that the input samples carry reaches the output window along {axis}: its rays "
        f"have spatial frequencies {band.inner[0]:.4g} to {band.inner[1]:.4g} cycles/m, the grid "
        f"carries up to {band.nyquist:.4g}; the field there is 0. Use a finer input grid or an "
        "output nearer to the axis."
    )


def _transfer(
    r: Request, shape: tuple[int, int], frequencies: list[np.ndarray], weights: list[np.ndarray]
) -> Transfer:
    return Transfer(
        shape, (frequencies[0], frequencies[1]), (weights[0], weights[1]), r.z, r.wavelength
    )


def _lattice(band: Band) -> np.ndarray:
    """Whole multiples of the frequency step inside the band; one of them where it is empty."""
    if band.is_empty:
        return np.zeros(1)
    low = math.ceil(band.low * band.window - LATTICE_SLACK)
    return np.arange(low, low + _count(band), dtype=np.float64)


def _count(band: Band) -> int:
    """How many frequencies `_lattice` has."""
    if band.is_empty:
        return 1
    low = math.ceil(band.low * band.window - LATTICE_SLACK)
    return max(0, math.floor(band.high * band.window + LATTICE_SLACK) - low) + 1


def _halved(f: np.ndarray, band: Band) -> np.ndarray:
    """Half the weight for a frequency exactly on the Nyquist frequency, which it shares."""
    return np.where(np.abs(np.abs(f) / band.nyquist - 1) < 1e-12, 0.5, 1.0)


def _to_frequencies(r: Request, axis: int, f: np.ndarray, window: float) -> Line:
    """U(f) = sum u(x) exp(-2 pi i f x) dx, x from the input's central sample."""
    n, d = r.grid.shape[axis], r.grid.pitch[axis]
    middle = f[f.size // 2]
    x = (np.arange(n) - n // 2) * d
    post = np.full(f.size, d, np.complex128)
    return chirp_z(n, f.size, -d / window, pre=phasor(-middle * x), post=post)


def _padded_into(r: Request, axis: int, band: Band) -> int:
    """Length of an FFT of the band's window where it is less work than a chirp-z transform, or 0.

    Of short transforms most is starting them.
    """
    n, d = r.grid.shape[axis], r.grid.pitch[axis]
    if band.is_empty or any(band.clipped) or band.window > 8 * (n + _count(band)) * d:
        return 0
    length = max(n, math.ceil(band.window / d * (1 - ROUNDING)))
    while has_large_prime(length):
        length += 1
    count = _count(replace(band, window=length * d))
    chirps = smooth_length(n + _count(band) - 1)
    less = length * math.log2(length) < 2 * chirps * math.log2(chirps)
    return length if length >= SHORT and count <= length and less else 0


def _padded_to_frequencies(r: Request, axis: int, index: np.ndarray, length: int) -> Line:
    """The same of the frequencies index/(length dx), by an FFT that begins at the first of them."""
    n, d = r.grid.shape[axis], r.grid.pitch[axis]
    first, middle = int(index[0]), n // 2
    pre = phasor(-(first * (np.arange(n) - middle) % length) / length)
    post = phasor((np.arange(index.size) * middle % length) / length) * d
    return Line(n, index.size, length, "forward", pre=pre, post=post)


def _from_frequencies(r: Request, axis: int, f: np.ndarray, window: float, offset: float) -> Line:
    """u(x) = sum U(f) exp(2 pi i f x) df at the output's samples, x from ``offset`` on."""
    m, d = r.target.shape[axis], r.target.pitch[axis]
    middle = f[f.size // 2]
    x = (np.arange(m) - m // 2) * d
    return chirp_z(f.size, m, d / window, pre=phasor(f * offset) / window, post=phasor(middle * x))


def _used(bands: list[Band], r: Request) -> tuple[tuple[float, float], tuple[float, float]]:
    y, x = (
        (0.0, 0.0) if n == 1 else (band.low, band.high)
        for n, band in zip(r.grid.shape, bands, strict=True)
    )
    return (y, x)


_METHODS = {
    "as": angular_spectrum,
    "blas": band_limited,
    "cblas": corrected,
    "rs": sommerfeld,
    "one-step": rayleigh_sommerfeld_in_one_step,
    "fresnel-tf": fresnel.transfer_function,
    "fresnel-ir": fresnel.impulse_response,
    "fresnel-1fft": fresnel.one_step,
    "fresnel-multistep": fresnel.many_steps,
}
