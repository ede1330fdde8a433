"""The command ``clplen sampling``: what a propagation would do, without doing it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import click

from clplen.cli.shared.console import note
from clplen.cli.shared.options import Length, Lengths, Shape
from clplen.errors import SamplingError
from clplen.reprs import columns
from clplen.units import angle, both, interval, metres
from clplen.wave.elements.lens import LensSampling, lens_sampling, lenslet_sampling
from clplen.wave.elements.lenslets import SMALLEST_PITCH
from clplen.wave.field.field import Grid
from clplen.wave.propagation import fresnel
from clplen.wave.propagation.band import GUARD, fully_sampled_distance
from clplen.wave.propagation.description import FREE_GRID, METHODS, Description, Request
from clplen.wave.propagation.methods import describe
from clplen.wave.propagation.plan_report import report

Rows = Iterable[tuple[str, str]]
LONGEST_WAVE = 1e-3  # metres; beyond, a unit was forgotten
_SAME = 1e-9  # of a distance


@click.command()
@click.option("--pitch", type=Lengths("positive"), required=True, help="Pitch of the samples.")
@click.option("--shape", type=Shape(), required=True, help="Number of samples of the field.")
@click.option("--wavelength", type=Length("positive"), required=True)
@click.option(
    "--z", "distances", type=Length(), multiple=True, help="Distance of propagation; repeatable."
)
@click.option("--method", type=click.Choice(METHODS), default="auto", show_default=True)
@click.option(
    "--pad",
    type=click.FloatRange(1, 64),
    default=2,
    show_default=True,
    help="Ratio of the window to the field; 1 is periodic.",
)
@click.option(
    "--guard",
    type=click.FloatRange(0, 100),
    default=GUARD,
    show_default=True,
    help="Guard band in Fresnel widths.",
)
@click.option("--support", type=Lengths("positive"), help="Width that carries light.")
@click.option("--out-pitch", type=Lengths("positive"), help="Pitch of the result.")
@click.option("--out-shape", type=Shape(), help="Number of samples of the result.")
@click.option("--out-offset", type=Lengths(one=False), help="Centre of the result.")
@click.option("--lens", "f", type=Length("not 0"), metavar="F", help="Focal length of a lens.")
@click.option(
    "--diameter", type=Length("positive"), help="Diameter of the lens; default: the window."
)
@click.option(
    "--arriving",
    type=Length("not 0"),
    help="Distance before the lens of the point that its light comes from; negative: behind it.",
)
@click.option(
    "--lenslets",
    type=(Length("positive"), Length("not 0")),
    metavar="PITCH F",
    help="Pitch and focal length of lenslets; with --diameter, at each --z behind the lens.",
)
def sampling(
    pitch: Any, shape: Any, wavelength: float, distances: tuple[float, ...], **words: Any
) -> None:
    """Say how finely a propagation, a lens and lenslets are sampled; compute nothing.

    Lengths have units: pm nm um mm cm m km; a bare number is metres. One length or number is that
    of both axes; 5umx6.6um and 2048x3030 are y (rows) and x.

    \b
    Example:
      clplen sampling --pitch 6.6um --shape 3030 --wavelength 550nm --z 240mm
      clplen sampling --pitch 6.6um --shape 3030 --wavelength 550nm --z 240mm \\
        --lens 120mm --diameter 3.6mm --arriving 240mm --lenslets 150um 10mm
    """
    _check(words)
    grid = Grid(shape, pitch)
    options = {name: words[name] for name in ("method", "pad", "guard", "support")}
    wanted = [
        Request(grid, z, wavelength, out_grid=_out_grid(grid, words), **options) for z in distances
    ]
    made = [describe(one) for one in wanted]
    _say("Grid", _grid_rows(grid, wavelength))
    if wavelength > LONGEST_WAVE:
        note(
            f"The wavelength is {metres(wavelength)}, which is no light: a bare number is metres, "
            "write 550nm for nanometres."
        )
    for one in made:
        _say(f"z = {metres(one.request.z)}", _propagation_rows(one))
        if one.warning:
            note(one.warning)
    if wanted:
        _say_methods(wanted)
    if words["f"] is not None:
        _say_lens(grid, wavelength, words["f"], words["diameter"], words["arriving"])
    if words["lenslets"] is not None:
        lenslets, f_mu = words["lenslets"]
        _say_lenslets(grid, wavelength, lenslets, f_mu, words["diameter"], distances)


def _check(words: dict[str, Any]) -> None:
    """Refuse words that mean nothing without another."""
    if words["diameter"] is not None and words["f"] is None and words["lenslets"] is None:
        raise click.UsageError("--diameter is that of a lens: give --lens or --lenslets, too.")
    if words["arriving"] is not None and words["f"] is None:
        raise click.UsageError("--arriving is about the light at a lens: give --lens, too.")


def _out_grid(grid: Grid, words: dict[str, Any]) -> Grid | None:
    pitch, shape, offset = (words[f"out_{name}"] for name in ("pitch", "shape", "offset"))
    if pitch is None and shape is None and offset is None:
        return None
    return Grid(shape or grid.shape, pitch or grid.pitch, origin=offset or (0.0, 0.0))


def _say(title: str, rows: Rows) -> None:
    click.echo(title)
    for name, value in rows:
        click.echo(f"  {name:<18}{value}")
    click.echo()


def _grid_rows(grid: Grid, wavelength: float) -> Rows:
    axes = [axis for axis in (0, 1) if grid.shape[axis] > 1] or [1]
    sides, pitches = [grid.shape[a] for a in axes], [grid.pitch[a] for a in axes]
    window = both([grid.extent[a] for a in axes], lambda value: metres(value, 4))
    yield "samples", f"{grid.shape[0]} x {grid.shape[1]} of {both(pitches, metres)}"
    yield "window", f"{window} at {metres(wavelength)}"
    for axis, d in zip(axes, pitches, strict=True):
        name = "Nyquist" if len(set(pitches)) == 1 else f"Nyquist {'yx'[axis]}"
        if d != pitches[0] or axis == axes[0]:
            yield name, f"{0.5e-3 / d:.4g} cycles/mm, {angle(1 / (2 * d), wavelength)}"
    steps = [n * d * d / wavelength for n, d in zip(sides, pitches, strict=True)]
    yield "N dx^2/lam", both(steps, lambda value: metres(value, 4))
    reach = min(
        fully_sampled_distance(n, d, wavelength) for n, d in zip(sides, pitches, strict=True)
    )
    yield "fully sampled", f"{interval(0, reach)} (transfer function without padding)"


def _propagation_rows(made: Description) -> Rows:
    """The report, and what auto would have done where it was not asked."""
    (_, method), *rest = report(made, "tables").rows
    wanted = made.request
    yield ("auto takes" if wanted.method == "auto" else "method"), method
    if wanted.method != "auto":
        choice = describe(replace(wanted, method="auto"))
        yield "auto would take", f"{choice.method}: {choice.why}"
    yield from rest


def _say_methods(wanted: list[Request]) -> None:
    """Every method on this grid: the distances at which it is sampled, and each one asked for."""
    rows = [["method", "sampled for z", *(f"at {metres(r.z)}" for r in wanted)]]
    for method in METHODS[1:]:
        own = replace(wanted[0], method=method, out_grid=None)
        rows.append([method, _valid(own), *(_verdict(r, method) for r in wanted)])
    errors = [_paraxial_error(r) for r in wanted]
    rows.append(["paraxial phase", "", *(f"wrong by up to {error:.2g} rad" for error in errors)])
    click.echo(f"Methods with --pad {wanted[0].pad:g}")
    for line in columns(rows, "<" * len(rows[0])):
        click.echo(f"  {line}")
    click.echo()


def _valid(r: Request) -> str:
    """The distances at which a method is sampled, whatever z is."""
    if r.method == "fresnel-multistep":
        return interval(0.0, fresnel.absorbed_distance(r))
    low, high = describe(replace(r, z=1.0)).valid
    return interval(low, high) + (", periodic" if r.method == "as" and r.pad == 1 else "")


def _verdict(r: Request, method: str) -> str:
    """Whether a method is sampled at a distance, and what else counts there."""
    if r.target != r.grid and method not in FREE_GRID:
        return "no, has its own grid"
    if r.z == 0:
        return "no, pitch 0" if method == "fresnel-1fft" else "yes, the field"
    own = replace(r, method=method)
    if method == "fresnel-multistep":
        word = "yes" if abs(r.z) < fresnel.absorbed_distance(own) else "no"
        return f"{word}, whole steps: {fresnel.steps(own)}"
    try:
        made = describe(own)
    except SamplingError:  # more work than is done
        return "no"
    low, high = made.valid
    if not low * (1 - _SAME) <= abs(r.z) <= high * (1 + _SAME):
        return "no"
    if method == "fresnel-1fft":
        pitches = [made.out_grid.pitch[a] for a in r.axes]
        return f"yes, pitch {both(pitches, lambda value: metres(value, 4))}" if pitches else "yes"
    used = 1 - report(made, "tables").lost_band
    return f"yes, {100 * used:.3g} % of band" if method == "blas" and used < 1 else "yes"


def _paraxial_error(r: Request) -> float:
    own = replace(r, method="fresnel-tf", out_grid=None)
    return report(describe(own), "tables").paraxial_error


def _say_lens(
    grid: Grid, wavelength: float, f: float, diameter: float | None, arriving: float | None
) -> None:
    found = lens_sampling(
        grid, f, wavelength=wavelength, diameter=diameter, arriving=arriving or math.inf
    )
    width = metres(2 * found.radius, 4) if diameter is None else metres(diameter)
    _say(f"Lens, f = {metres(f)}, D = {width}", _lens_rows(found, f, arriving))
    extents = [grid.extent[axis] for axis in (0, 1) if grid.shape[axis] > 1]
    if diameter is not None and extents and diameter > min(extents):
        width = metres(min(extents)).replace(" ", "")
        note(
            f"The window of {metres(min(extents), 4)} is smaller than the lens, so that the window "
            f"decides which light passes: take more samples, or --diameter {width}."
        )
    if not found.is_sampled(found.alone):
        note(
            f"The phase of the lens is aliased beyond R_max = {metres(found.largest_radius, 4)}: "
            f"take a focal length from {metres(found.shortest_focal_length, 4)} on, or a finer "
            "pitch."
        )


def _lens_rows(found: LensSampling, f: float, arriving: float | None) -> Rows:
    said = "sampled" if found.is_sampled(found.alone) else "aliased"
    largest = metres(found.largest_radius, 4)
    yield "radius", f"R = {metres(found.radius, 4)}; R_max = lam f/(2 dx) = {largest}: {said}"
    yield "focal length", f"f_min = D dx/lam = {metres(found.shortest_focal_length, 4)}"
    yield "f-number", f"f/{found.f_number:.4g}; fastest sampled dx/lam: f/{found.fastest:.4g}"
    if arriving is None:
        return
    slopes = ("light before it", found.arriving), ("light behind it", found.behind)
    for name, slope in slopes:
        said = "sampled" if found.is_sampled(slope) else "aliased"
        yield name, f"NA {slope:.4g} at the rim; limit lam/(2 dx) = {found.limit:.4g}: {said}"


def _say_lenslets(
    grid: Grid,
    wavelength: float,
    pitch: float,
    f: float,
    diameter: float | None,
    distances: tuple[float, ...],
) -> None:
    """d/(2 f_mu) + D/(2 z2) <= lam/(2 dx), for a plane wave and behind the lens."""
    varied = [d for n, d in zip(grid.shape, grid.pitch, strict=True) if n > 1]
    samples = max(varied, default=max(grid.pitch))
    rows = [("samples", f"{pitch / samples:.4g} a lenslet")]
    cases = [("in a plane wave", 0.0, math.inf)]
    if diameter is not None:
        cases += [(f"lens {metres(z)} away", diameter, z) for z in distances if z]
    for name, width, z in cases:
        found = lenslet_sampling(
            pitch, f, samples=samples, wavelength=wavelength, diameter=width, z=z
        )
        slopes = f"d/(2 f) = {found.lenslet:.4g}"
        if width:
            slopes += f" + D/(2 z) = {found.lens:.4g}"
        said = "sampled" if found.is_sampled else "aliased"
        least = found.shortest_focal_length
        from_ = f"for f from {metres(least, 4)} on" if math.isfinite(least) else "for no f"
        rows.append((name, f"{slopes}; limit lam/(2 dx) = {found.limit:.4g}: {said}, {from_}"))
        if not found.is_sampled:
            note(f"The lenslets are aliased ({name}): they are sampled {from_}.")
    _say(f"Lenslets, pitch {metres(pitch)}, f = {metres(f)}", rows)
    if pitch < SMALLEST_PITCH * samples:
        note(f"The lenslets need a pitch of at least {SMALLEST_PITCH} samples.")
