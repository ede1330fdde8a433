"""``clplen sampling``: the sampling of a propagation, without computing it."""

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
MAX_WAVELENGTH = 1e-3  # metres; a longer one is taken as a forgotten unit
RELATIVE_TOLERANCE = 1e-9  # of a distance: rounding at the ends of a sampled range


@click.command()
@click.option("--pitch", type=Lengths("positive"), required=True, help="Pitch of the samples.")
@click.option("--shape", type=Shape(), required=True, help="Number of samples of the field.")
@click.option(
    "--wavelength", type=Length("positive"), required=True, help="Wavelength, such as 550nm."
)
@click.option(
    "--z", "distances", type=Length(), multiple=True, help="Propagation distance; may be repeated."
)
@click.option(
    "--method",
    type=click.Choice(METHODS),
    default="auto",
    show_default=True,
    help="Propagation method.",
)
@click.option(
    "--pad",
    type=click.FloatRange(1, 64),
    default=2,
    show_default=True,
    help="Width of the padded window, relative to the field; 1 is periodic.",
)
@click.option(
    "--guard",
    type=click.FloatRange(0, 100),
    default=GUARD,
    show_default=True,
    help="Width of the guard band, in Fresnel widths.",
)
@click.option("--support", type=Lengths("positive"), help="Width of the lit region.")
@click.option("--out-pitch", type=Lengths("positive"), help="Pitch of the output samples.")
@click.option("--out-shape", type=Shape(), help="Number of output samples.")
@click.option("--out-offset", type=Lengths(accepts_single=False), help="Centre of the output.")
@click.option("--lens", "f", type=Length("not 0"), metavar="F", help="Focal length of a lens.")
@click.option(
    "--diameter", type=Length("positive"), help="Diameter of the lens. Default: the window."
)
@click.option(
    "--arriving",
    type=Length("not 0"),
    help="Distance of the point source in front of the lens; negative for light that converges to "
    "a point behind it.",
)
@click.option(
    "--lenslets",
    type=(Length("positive"), Length("not 0")),
    metavar="PITCH F",
    help="Pitch and focal length of a lenslet array. With --diameter it is checked at each --z "
    "behind the lens.",
)
def sampling(
    pitch: Any, shape: Any, wavelength: float, distances: tuple[float, ...], **arguments: Any
) -> None:
    """Check the sampling of a propagation, lens or lenslets.

    No field is computed. Lengths have units: pm nm um mm cm m km; a bare number is in metres. A
    single length or number sets both axes; pairs such as 5umx6.6um or 2048x3030 are y (rows) and x.

    \b
    Example:
      clplen sampling --pitch 6.6um --shape 3030 --wavelength 550nm --z 240mm
      clplen sampling --pitch 6.6um --shape 3030 --wavelength 550nm --z 240mm \\
        --lens 120mm --diameter 3.6mm --arriving 240mm --lenslets 150um 10mm
    """
    _check(arguments)
    grid = Grid(shape, pitch)
    options = {name: arguments[name] for name in ("method", "pad", "guard", "support")}
    out_grid = _out_grid(grid, arguments)
    requests = [Request(grid, z, wavelength, out_grid=out_grid, **options) for z in distances]
    descriptions = [describe(request) for request in requests]
    _print_table("Grid", _grid_rows(grid, wavelength))
    if wavelength > MAX_WAVELENGTH:
        note(
            f"the wavelength is {metres(wavelength)}: a bare number is in metres, write for "
            "example 550nm."
        )
    for description in descriptions:
        _print_table(f"z = {metres(description.request.z)}", _propagation_rows(description))
        if description.warning:
            note(description.warning)
    if requests:
        _print_methods(requests)
    if arguments["f"] is not None:
        _print_lens(grid, wavelength, arguments["f"], arguments["diameter"], arguments["arriving"])
    if arguments["lenslets"] is not None:
        lenslets, f_mu = arguments["lenslets"]
        _print_lenslets(grid, wavelength, lenslets, f_mu, arguments["diameter"], distances)


def _check(arguments: dict[str, Any]) -> None:
    """Raise an error if an option lacks the option it depends on."""
    if (
        arguments["diameter"] is not None
        and arguments["f"] is None
        and arguments["lenslets"] is None
    ):
        raise click.UsageError("--diameter needs --lens or --lenslets.")
    if arguments["arriving"] is not None and arguments["f"] is None:
        raise click.UsageError("--arriving needs --lens.")


def _out_grid(grid: Grid, arguments: dict[str, Any]) -> Grid | None:
    pitch, shape, offset = (arguments[f"out_{name}"] for name in ("pitch", "shape", "offset"))
    if pitch is None and shape is None and offset is None:
        return None
    return Grid(shape or grid.shape, pitch or grid.pitch, origin=offset or (0.0, 0.0))


def _print_table(title: str, rows: Rows) -> None:
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


def _propagation_rows(description: Description) -> Rows:
    """Yield the rows of the report, and the choice of "auto" if another method is set."""
    (_, method), *rest = report(description, "tables").rows
    request = description.request
    yield ("auto selects" if request.method == "auto" else "method"), method
    if request.method != "auto":
        choice = describe(replace(request, method="auto"))
        yield "auto would select", f"{choice.method}: {choice.why}"
    yield from rest


def _print_methods(requests: list[Request]) -> None:
    """Print the distances at which each method is sampled, and a verdict for each request."""
    rows = [["method", "sampled for z", *(f"at {metres(r.z)}" for r in requests)]]
    for method in METHODS[1:]:
        free = replace(requests[0], method=method, out_grid=None)
        rows.append([method, _valid(free), *(_verdict(r, method) for r in requests)])
    errors = [_paraxial_error(r) for r in requests]
    rows.append(["paraxial phase", "", *(f"wrong by up to {error:.2g} rad" for error in errors)])
    click.echo(f"Methods with --pad {requests[0].pad:g}")
    for line in columns(rows, "<" * len(rows[0])):
        click.echo(f"  {line}")
    click.echo()


def _valid(r: Request) -> str:
    """Return the distances at which a method is sampled."""
    if r.method == "fresnel-multistep":
        return interval(0.0, fresnel.absorbed_distance(r))
    low, high = describe(replace(r, z=1.0)).valid
    return interval(low, high) + (", periodic" if r.method == "as" and r.pad == 1 else "")


def _verdict(r: Request, method: str) -> str:
    """Return a verdict on the sampling of a method at a distance, with its restrictions."""
    if r.target != r.grid and method not in FREE_GRID:
        return "no, sets its own grid"
    if r.z == 0:
        return "no, pitch 0" if method == "fresnel-1fft" else "yes, the field"
    request = replace(r, method=method)
    if method == "fresnel-multistep":
        word = "yes" if abs(r.z) < fresnel.absorbed_distance(request) else "no"
        return f"{word}, equal steps: {fresnel.steps(request)}"
    try:
        description = describe(request)
    except SamplingError:  # raised for requests beyond the supported cost
        return "no"
    low, high = description.valid
    if not low * (1 - RELATIVE_TOLERANCE) <= abs(r.z) <= high * (1 + RELATIVE_TOLERANCE):
        return "no"
    if method == "fresnel-1fft":
        pitches = [description.out_grid.pitch[a] for a in r.axes]
        return f"yes, pitch {both(pitches, lambda value: metres(value, 4))}" if pitches else "yes"
    used = 1 - report(description, "tables").lost_band
    return f"yes, {100 * used:.3g} % of band" if method == "blas" and used < 1 else "yes"


def _paraxial_error(r: Request) -> float:
    request = replace(r, method="fresnel-tf", out_grid=None)
    return report(describe(request), "tables").paraxial_error


def _print_lens(
    grid: Grid, wavelength: float, f: float, diameter: float | None, arriving: float | None
) -> None:
    lens = lens_sampling(
        grid, f, wavelength=wavelength, diameter=diameter, arriving=arriving or math.inf
    )
    width = metres(2 * lens.radius, 4) if diameter is None else metres(diameter)
    _print_table(f"Lens, f = {metres(f)}, D = {width}", _lens_rows(lens, f, arriving))
    extents = [grid.extent[axis] for axis in (0, 1) if grid.shape[axis] > 1]
    if diameter is not None and extents and diameter > min(extents):
        width = metres(min(extents)).replace(" ", "")
        note(
            f"the window of {metres(min(extents), 4)} is smaller than the lens and clips the "
            f"light: use more samples, or --diameter {width}."
        )
    if not lens.is_sampled(lens.alone):
        note(
            f"the phase of the lens is aliased beyond R_max = {metres(lens.largest_radius, 4)}: "
            f"use a focal length of at least {metres(lens.shortest_focal_length, 4)}, or a finer "
            "pitch."
        )


def _lens_rows(lens: LensSampling, f: float, arriving: float | None) -> Rows:
    verdict = "sampled" if lens.is_sampled(lens.alone) else "aliased"
    largest = metres(lens.largest_radius, 4)
    yield "radius", f"R = {metres(lens.radius, 4)}; R_max = lam f/(2 dx) = {largest}: {verdict}"
    yield "focal length", f"f_min = D dx/lam = {metres(lens.shortest_focal_length, 4)}"
    yield "f-number", f"f/{lens.f_number:.4g}; fastest sampled dx/lam: f/{lens.fastest:.4g}"
    if arriving is None:
        return
    slopes = ("incoming light", lens.arriving), ("outgoing light", lens.behind)
    for name, slope in slopes:
        verdict = "sampled" if lens.is_sampled(slope) else "aliased"
        yield name, f"NA {slope:.4g} at the rim; limit lam/(2 dx) = {lens.limit:.4g}: {verdict}"


def _print_lenslets(
    grid: Grid,
    wavelength: float,
    pitch: float,
    f: float,
    diameter: float | None,
    distances: tuple[float, ...],
) -> None:
    """Print the check d/(2 f_mu) + D/(2 z2) <= lam/(2 dx), for a plane wave and a lens."""
    varied = [d for n, d in zip(grid.shape, grid.pitch, strict=True) if n > 1]
    samples = max(varied, default=max(grid.pitch))
    rows = [("samples", f"{pitch / samples:.4g} per lenslet")]
    cases = [("plane wave", 0.0, math.inf)]
    if diameter is not None:
        cases += [(f"lens {metres(z)} away", diameter, z) for z in distances if z]
    for name, width, z in cases:
        check = lenslet_sampling(
            pitch, f, samples=samples, wavelength=wavelength, diameter=width, z=z
        )
        slopes = f"d/(2 f) = {check.lenslet:.4g}"
        if width:
            slopes += f" + D/(2 z) = {check.lens:.4g}"
        verdict = "sampled" if check.is_sampled else "aliased"
        shortest = check.shortest_focal_length
        limit = f"for f from {metres(shortest, 4)} on" if math.isfinite(shortest) else "for no f"
        rows.append((name, f"{slopes}; limit lam/(2 dx) = {check.limit:.4g}: {verdict}, {limit}"))
        if not check.is_sampled:
            note(f"the lenslets are aliased ({name}): they are sampled {limit}.")
    _print_table(f"Lenslets, pitch {metres(pitch)}, f = {metres(f)}", rows)
    if pitch < SMALLEST_PITCH * samples:
        note(f"the lenslets need a pitch of at least {SMALLEST_PITCH} samples.")
