"""Choice of the method of a propagation, and descriptions of the exact methods.

The exact methods are as, blas and cblas by FFT, cblas by chirp-z transform, and rs by its sampled
kernel; fresnel.py has the paraxial methods.
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
    exceeds_energy,
    flops,
    padded_length,
)
from clplen.wave.propagation.transfer_function import Sommerfeld, Transfer, fft_frequencies
from clplen.wave.propagation.windowed_kernel import WindowedKernel, kernel_axis, kernel_length

FFT_WINDOW = 2.5  # largest window over grid at which the FFT route is cheaper
LATTICE_SLACK = 1e-9  # rounding of a frequency step
MAX_FREQUENCIES = 10**6  # maximum number of frequencies along an axis
STARTING = 5e6  # operations in the time to start a map of both axes
SHORT = 512  # length of a transform below which fewer samples save little
MIN_FREQUENCIES = 64  # minimum number of frequencies of a band with hard edges
NEAR_WINDOW = 2.2  # largest window over grid at which FFTs of the window are cheapest
SAMPLED_KERNEL = 0.8  # fraction of the Nyquist frequency up to which the RS kernel is accurate
DECAYED = 18.4  # attenuation in nepers, 160 dB, of negligible evanescent waves
FAINT = 4.0  # attenuation in nepers above which the sum over samples beats a truncated band
MAX_KERNEL_SAMPLES = 2**24  # limit of a windowed kernel, a few seconds on a CPU,
KERNEL_SHARE = 64  # or this multiple of the samples of a window with both grids
KERNEL_BYTES = 24  # peak bytes per sample in complex64: kernel, transform, tables
KERNEL_SECONDS, LINE_SECONDS = 2e-7, 1e-6  # seconds per sample and per sample of an axis, 2 cores
SMOOTH_KERNEL = 3  # minimum z in samples for a kernel peak sampled to 160 dB: exp(-2 pi z/dx)

MOVED = "the output has another pitch or centre"
GRAZING = "waves that graze the plane leave every window"


def describe(r: Request) -> Description:
    """Return the description of a request."""
    if r.z == 0 and r.target == r.grid and r.method != "fresnel-1fft":
        return _identity(r)
    return automatic(r) if r.method == "auto" else _METHODS[r.method](r)


def automatic(r: Request) -> Description:
    """Return the description of the cheapest exact method at this distance, never paraxial."""
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
    sampled_kernel = bool(spans) and not near and all(map(_has_sampled_kernel, spans))
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
    """Return the sum in one step if it is exact and cheaper than the sum over the band."""
    used = [bands[axis] for axis in r.axes]
    if r.z == 0 or r.guard == 0 or not used or any(any(b.clipped) or b.is_empty for b in used):
        return None
    series = one_step.best_series(r)
    if series.bound[1] > one_step.TOLERANCE:
        return None
    counts = [1 if n == 1 else _count(b) for n, b in zip(r.grid.shape, bands, strict=True)]
    description, over_band = _one_step(r, series, MOVED), _band_flops(r, bands, counts)
    if flops(description) + STARTING * (len(description.terms) - 1) >= over_band:
        return None
    share = f"{100 * flops(description) / over_band:.2g} % of the work of"
    return replace(description, why=f"{MOVED}; {share} {counts[0]} x {counts[1]} frequencies")


def _band_flops(r: Request, bands: list[Band], counts: list[int]) -> float:
    """Return `flops` of `by_chirps` for numbers of frequencies along (y, x)."""
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
    """Describe the sum over samples by a chirp-z transform between chirps, with a series."""
    if r.z == 0:
        raise SamplingError(
            f"one-step requires a distance z other than 0; use {argument('method', 'auto')} to "
            "resample a field."
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
        refused = series.bound[1] > one_step.MAX_ERROR
        problem = "does not converge" if refused else "is not exact"
        warning = (
            f"The series for the path {problem} in one-step at z = {r.z:g} m: from "
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
        is_refused=series.bound[1] > one_step.MAX_ERROR,
        terms=tuple(terms),
    )


def _has_sampled_kernel(span: AxisSpan, nepers: float = DECAYED) -> bool:
    """Return True if the samples represent the kernel.

    No ray is then too steep, or waves beyond the Nyquist frequency are evanescent and have decayed.
    """
    if span.geometric(span.reach) <= SAMPLED_KERNEL * span.nyquist:
        return True
    beyond = (span.wavelength * span.nyquist) ** 2 - 1
    turns = abs(span.z) / span.wavelength
    return beyond > 0 and 2 * math.pi * turns * math.sqrt(beyond) >= nepers


def _leaves_every_window(r: Request, bands: list[Band]) -> bool:
    """Return True if waves of the band graze the plane, along an axis or across both."""
    return any(bands[axis].grazing for axis in r.axes) or (
        sum((r.wavelength * max(abs(bands[a].low), abs(bands[a].high))) ** 2 for a in r.axes) >= 1
    )


def _far(r: Request, why: str) -> Description:
    """Return the sampled kernel, or the chirp-z route if its few frequencies cost less."""
    kernel = sommerfeld(r, why)
    chirps = corrected(r, why, "chirp-z")
    if flops(chirps) >= flops(kernel):
        return kernel
    count = " x ".join(str(n) for n in chirps.into.shape_after(r.grid.shape))
    share = _work_share(chirps, kernel)
    return replace(chirps, why=f"{why}; {count} frequencies, {share} of its work")


def _work_share(description: Description, other: Description) -> str:
    return f"{100 * flops(description) / flops(other):.0f} %"


def _evanescent(r: Request) -> Description:
    """Return the angular spectrum with evanescent waves, in a window that holds both grids."""
    lengths = [
        n if n == 1 else max(length, smooth_length(n + max(n, m)))
        for n, m, length in zip(r.grid.shape, r.target.shape, fft_lengths(r, r.bands), strict=True)
    ]
    bands = [whole_band(r.span(axis)) for axis in (0, 1)]
    why = f"abs(z) = {abs(r.z):.3g} m <= {EVANESCENT_REACH} lam: evanescent waves count"
    valid = (0.0, EVANESCENT_REACH * r.wavelength)
    return by_fft(r, lengths, bands, method="as", why=why, valid=valid)


def _whole_band(r: Request, why: str) -> Description:
    """Return the angular spectrum in a window for its steepest rays, at least twice the grid."""
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
    """Describe H over all sampled frequencies (Goodman 2005, eq. 3-66), window ``pad`` x grid."""
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
            f"The transfer function at z = {r.z:g} m is aliased above {reach:.4g} m. Use "
            f"{argument('method', 'auto')} or 'blas'{wider}."
        )
    bands = [whole_band(r.span(axis)) for axis in (0, 1)]
    valid = (0.0, math.inf if periodic else reach)
    return by_fft(r, lengths, bands, method="as", why=why, valid=valid, warning=warning)


def band_limited(r: Request) -> Description:
    """Describe H over the band that the window samples (Matsushima and Shimobaba 2009, eq. 13)."""
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
    """Describe H over the guarded band, with a window wide enough for aliases to miss the output.

    ``route`` is "fft" or "chirp-z"; by default the FFT if the grid allows it and the window is not
    much wider than the grid. With guard = 0 the band ends sharply at the geometric limit (figure
    2.7 of the thesis), and the window of the FFT route is that of ``pad``.
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
    """Return window lengths of the FFT route: the bands' windows, at least both grids."""
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
    """Describe padding, transform, product with H in each axis' band, transform back, cropping."""
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
    """Describe the sum over the band's frequencies, by chirp-z transforms."""
    into, back, frequencies, weights = [], [], [], []
    _limit_frequencies(r, bands)
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


def _limit_frequencies(r: Request, bands: list[Band]) -> None:
    """Raise if the number of frequencies along an axis exceeds every device's memory."""
    count = max((_count(bands[axis]) for axis in r.axes), default=1)
    if count > MAX_FREQUENCIES:
        raise SamplingError(
            f"cblas is limited to {MAX_FREQUENCIES:,} frequencies along an axis, but {r.target} "
            f"requires {count:,}; use a smaller output window, a smaller support, or, at large "
            f"distances, {argument('method', 'one-step')}."
        )


def sommerfeld(r: Request, why: str = "asked for") -> Description:
    """Describe the convolution with the sampled Rayleigh-Sommerfeld I kernel, window 2x the grid.

    For another grid the spectrum of the kernel in a smooth window is used.
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
        is_refused=exceeds_energy(r),
    )


def _kernel_sampling(r: Request) -> tuple[float, float, str]:
    """Return the kernel's largest phase step over pi, its smallest distance, and a warning."""
    spans = [r.span(axis) for axis in r.axes]
    step = max((span.geometric(span.reach) / span.nyquist for span in spans), default=0.0)
    nearest = max((kernel_sampled_distance(span) for span in spans), default=0.0)
    if abs(r.z) >= nearest:
        return step, nearest, ""
    warning = (
        f"The Rayleigh-Sommerfeld kernel at z = {r.z:g} m is aliased below {nearest:.4g} m. Use "
        f"{argument('method', 'auto')} or {argument('method', 'cblas')}."
    )
    return step, nearest, warning


def _windowed_kernel(r: Request, why: str) -> Description:
    """Describe the kernel in a smooth window, its spectrum between chirp-z transforms.

    Its frequencies end at the Nyquist frequency unless waves beyond it do not arrive.
    """
    if r.z == 0:
        return corrected(r, why, "chirp-z")
    axes, into, back = [], [], []
    _require_small_kernel(r)
    for axis, n in enumerate(r.grid.shape):
        span = r.span(axis)
        kernel = kernel_axis(span, math.inf if _has_sampled_kernel(span, FAINT) else span.nyquist)
        axes.append(kernel)
        if n == 1:
            into.append(identity(1))
            back.append(identity(1))
            continue
        into.append(_to_frequencies(r, axis, kernel.frequencies, kernel.width))
        back.append(_from_frequencies(r, axis, kernel.frequencies, kernel.width, 0.0))
    factor = WindowedKernel((axes[0], axes[1]), r.z, r.wavelength)
    step, nearest, warning = _kernel_sampling(r)
    automatic = r.method == "auto"
    band = [(float(axis.frequencies[0]), float(axis.frequencies[-1])) for axis in axes]
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
    """Raise if a distance is so short that the kernel has many more samples than the grids."""
    lengths = [kernel_length(r.span(axis)) for axis in (0, 1)]
    both = math.prod(n + m for n, m in zip(r.grid.shape, r.target.shape, strict=True))
    count = math.prod(lengths)
    limit = max(MAX_KERNEL_SAMPLES, KERNEL_SHARE * both)
    if r.method == "rs" and (count > limit or max(lengths) > MAX_FREQUENCIES):
        seconds = KERNEL_SECONDS * count + LINE_SECONDS * sum(lengths)
        raise SamplingError(
            f"rs to another grid at z = {r.z:g} m requires a kernel of {lengths[0]:.3g} x "
            f"{lengths[1]:.3g} samples, {units.amount(KERNEL_BYTES * count, 'B')} in "
            f"complex64 and about {seconds:.2g} s; use {argument('method', 'auto')}."
        )


def _finer(band: Band) -> Band:
    """Widen the window of a band with hard edges until it has `MIN_FREQUENCIES` frequencies."""
    if band.guard > 0 or band.is_empty:
        return band
    return replace(band, window=max(band.window, MIN_FREQUENCIES / (band.high - band.low)))


def _grazing(r: Request) -> str:
    return (
        f"Waves that graze the plane leave the window of cblas at z = {r.z:g} m and return as "
        f"aliases; use {argument('method', 'auto')} or 'rs', or samples of more than half a "
        "wavelength."
    )


def _no_light(r: Request, band: Band, axis: str) -> str:
    return (
        f"No light reaches the output window along {axis}: its rays have spatial frequencies of "
        f"{band.inner[0]:.4g} to {band.inner[1]:.4g} cycles/m, above the input grid's Nyquist "
        f"frequency of {band.nyquist:.4g}; the field is 0. Use a finer input grid or an output "
        "nearer to the axis."
    )


def _transfer(
    r: Request, shape: tuple[int, int], frequencies: list[np.ndarray], weights: list[np.ndarray]
) -> Transfer:
    return Transfer(
        shape, (frequencies[0], frequencies[1]), (weights[0], weights[1]), r.z, r.wavelength
    )


def _lattice(band: Band) -> np.ndarray:
    """Return integer multiples of the frequency step inside the band; [0] for an empty band."""
    if band.is_empty:
        return np.zeros(1)
    low = math.ceil(band.low * band.window - LATTICE_SLACK)
    return np.arange(low, low + _count(band), dtype=np.float64)


def _count(band: Band) -> int:
    """Return the number of frequencies of `_lattice`."""
    if band.is_empty:
        return 1
    low = math.ceil(band.low * band.window - LATTICE_SLACK)
    return max(0, math.floor(band.high * band.window + LATTICE_SLACK) - low) + 1


def _halved(f: np.ndarray, band: Band) -> np.ndarray:
    """Return half the weight for a frequency equal to the Nyquist frequency, else 1."""
    return np.where(np.abs(np.abs(f) / band.nyquist - 1) < 1e-12, 0.5, 1.0)


def _to_frequencies(r: Request, axis: int, f: np.ndarray, window: float) -> Line:
    """Return U(f) = sum u(x) exp(-2 pi i f x) dx, x from the input's central sample."""
    n, d = r.grid.shape[axis], r.grid.pitch[axis]
    middle = f[f.size // 2]
    x = (np.arange(n) - n // 2) * d
    post = np.full(f.size, d, np.complex128)
    return chirp_z(n, f.size, -d / window, pre=phasor(-middle * x), post=post)


def _padded_into(r: Request, axis: int, band: Band) -> int:
    """Return the length of an FFT of the band's window, or 0 if a chirp-z transform is cheaper.

    Short transforms are dominated by their start.
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
    """Return `_to_frequencies` for index/(length dx), by an FFT that begins at the first."""
    n, d = r.grid.shape[axis], r.grid.pitch[axis]
    first, middle = int(index[0]), n // 2
    pre = phasor(-(first * (np.arange(n) - middle) % length) / length)
    post = phasor((np.arange(index.size) * middle % length) / length) * d
    return Line(n, index.size, length, "forward", pre=pre, post=post)


def _from_frequencies(r: Request, axis: int, f: np.ndarray, window: float, offset: float) -> Line:
    """Return u(x) = sum U(f) exp(2 pi i f x) df at the output's samples, x from ``offset``."""
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
