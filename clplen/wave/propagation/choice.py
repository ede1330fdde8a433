"""From a request to the description of its method; the choice of ``auto``."""

from __future__ import annotations

import math
from dataclasses import replace

from clplen.compute.lines import Separable, smooth_length
from clplen.wave.propagation import exact_methods, fresnel
from clplen.wave.propagation.band import EVANESCENT_REACH, whole_band
from clplen.wave.propagation.cost import flops
from clplen.wave.propagation.description import Description, any_distance, whole_bands
from clplen.wave.propagation.request import Request

NEAR_WINDOW = 2.2  # times the grid, up to which FFTs of the window beat every other way
SAMPLED_KERNEL = 0.8  # of the Nyquist frequency, up to which the RS kernel is accurate
SMOOTH_KERNEL = 3  # samples of z from which the kernel's peak is sampled to 160 dB: exp(-2 pi z/dx)
_METHODS = {
    "as": exact_methods.angular_spectrum,
    "blas": exact_methods.band_limited,
    "cblas": exact_methods.corrected,
    "rs": exact_methods.sommerfeld,
    "fresnel-tf": fresnel.transfer_function,
    "fresnel-ir": fresnel.impulse_response,
    "fresnel-1fft": fresnel.one_step,
    "fresnel-multistep": fresnel.many_steps,
}


def describe(r: Request) -> Description:
    """How a request is done: everything but the device.

    Raises
    ------
    SamplingError
        For fresnel-1fft at z = 0 or with another output pitch.
    """
    if r.z == 0 and r.target == r.grid and r.method != "fresnel-1fft":
        return _nothing(r)
    return automatic(r) if r.method == "auto" else _METHODS[r.method](r)


def automatic(r: Request) -> Description:
    """The cheapest of the methods that are exact at this distance; never a paraxial one."""
    if not r.is_aligned:
        return exact_methods.corrected(r, "the output has another pitch or centre", "chirp-z")
    bands = r.bands
    lengths = exact_methods.fft_lengths(r, bands)
    wide = max((lengths[axis] / r.grid.shape[axis] for axis in r.axes), default=1.0)
    ways = [r.way(axis) for axis in r.axes]
    share = max((way.geometric(way.reach) / way.nyquist for way in ways), default=0.0)
    kernel = (
        bool(ways)
        and share <= SAMPLED_KERNEL
        and abs(r.z) >= SMOOTH_KERNEL * max(way.pitch for way in ways)
        and r.target.shape == r.grid.shape
    )
    if any(way.is_evanescent for way in ways) and not kernel:
        return _touching(r)
    sampled = f"f_geo = {share:.3g} f_nyq"
    if all(bands[axis].is_whole for axis in r.axes) and (wide <= NEAR_WINDOW or not kernel):
        return _whole(r, f"f_geo + guard >= f_nyq ({sampled}): every sampled frequency arrives")
    if wide <= NEAR_WINDOW or (wide <= exact_methods.FFT_WINDOW and not kernel):
        limit = NEAR_WINDOW if wide <= NEAR_WINDOW else exact_methods.FFT_WINDOW
        return exact_methods.corrected(r, f"W = {wide:.3g} S <= {limit} S", "fft")
    if kernel:
        return _far(
            r, f"W = {wide:.3g} S > {NEAR_WINDOW} S and {sampled} <= {SAMPLED_KERNEL} f_nyq"
        )
    return exact_methods.corrected(r, f"W = {wide:.3g} S > {exact_methods.FFT_WINDOW} S", "chirp-z")


def _far(r: Request, why: str) -> Description:
    """The sampled kernel, or the few frequencies that are left where they are less work."""
    kernel = exact_methods.sommerfeld(r, why)
    few = exact_methods.corrected(r, why, "chirp-z")
    if flops(few) >= flops(kernel):
        return kernel
    count = " x ".join(str(n) for n in few.into.shape_after(r.grid.shape))
    return replace(few, why=f"{why}; {count} frequencies, {_share(few, kernel)} of its work")


def _share(one: Description, other: Description) -> str:
    return f"{100 * flops(one) / flops(other):.0f} %"


def _touching(r: Request) -> Description:
    """The angular spectrum with its evanescent waves, in a window that holds both grids."""
    lengths = [
        n if n == 1 else max(length, smooth_length(n + max(n, m)))
        for n, m, length in zip(
            r.grid.shape, r.target.shape, exact_methods.fft_lengths(r, r.bands), strict=True
        )
    ]
    bands = [whole_band(r.way(axis)) for axis in (0, 1)]
    why = f"abs(z) = {abs(r.z):.3g} m <= {EVANESCENT_REACH} lam: evanescent waves count"
    valid = (0.0, EVANESCENT_REACH * r.wavelength)
    return exact_methods.by_fft(r, lengths, bands, method="as", why=why, valid=valid)


def _whole(r: Request, why: str) -> Description:
    """The angular spectrum in a window that holds its steepest rays, at least twice the grid."""
    bands = [whole_band(r.way(axis)) for axis in (0, 1)]
    needed = exact_methods.fft_lengths(r, r.bands)
    lengths = [
        n if n == 1 else max(length, smooth_length(2 * n))
        for n, length in zip(r.grid.shape, needed, strict=True)
    ]
    return exact_methods.by_fft(r, lengths, bands, method="as", why=why, valid=any_distance())


def _nothing(r: Request) -> Description:
    method = "as" if r.method == "auto" else r.method
    return Description(
        request=r,
        method=method,
        why="z = 0: the field itself",
        out_grid=r.target,
        into=Separable(),
        back=Separable(),
        factor=None,
        kind="nothing",
        route="none",
        sampled="nothing",
        phase_step=0.0,
        valid=(0.0, math.inf),
        band=whole_bands(r),
    )
