"""``clplen calibrate``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.console import advance, check_output, check_suffix, progress_bar, read

if TYPE_CHECKING:
    from clplen.lightfield.metric.intrinsics import Intrinsics
    from clplen.lightfield.model.light_field import LightField

_COUNTS = re.compile(r"\s*(\d{1,4})\s*[x\u00d7]\s*(\d{1,4})\s*")
_OUTLIER_RATIO = 1.25  # ratio to the median rms above which the worst board is named


class Board(click.ParamType):
    """Number (rows, columns) of inner corners from text such as 6x9."""

    name = "ROWSxCOLUMNS"

    def get_metavar(self, param: Any, ctx: Any = None) -> str:
        return self.name

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if isinstance(value, tuple):
            return value
        match = _COUNTS.fullmatch(str(value))
        if match is None:
            self.fail(
                f"{value!r} is not a board: give rows and columns of its inner corners, such as "
                "6x9 for 7 x 10 squares.",
                param,
                ctx,
            )
        return int(match[1]), int(match[2])


@click.command(cls=options.Command)
@click.argument(
    "sources", metavar="INPUT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@options.output("OUT.json", "Output file of the intrinsics.")
@click.option(
    "--board",
    required=True,
    type=Board(),
    help="Number of inner corners of the checkerboard: 6x9 for 7 x 10 squares.",
)
@click.option(
    "--spacing",
    required=True,
    type=options.Length("positive"),
    help="Side of a square, for example 25mm; a bare number is in metres.",
)
@options.layout
@options.device
def calibrate(
    sources: tuple[Path, ...],
    output: Path,
    board: tuple[int, int],
    spacing: float,
    selector: str | None,
    **layout: Any,
) -> None:
    """Calibrate a light-field camera with a checkerboard.

    Each INPUT is a light field of the board in another pose. Take at least 3 poses,
    better 10. Tilt the board by 20 to 40 degrees in all directions, and cover the distances that
    you will measure. Pass OUT.json to other commands as --intrinsics: they rectify the views, and
    'clplen depth' gives metres.

    \b
    Example:
      clplen calibrate board_*.h5 --board 6x9 --spacing 25mm -o camera.json
      clplen depth scene.h5 -o depth.pfm --intrinsics camera.json --metric z.pfm --ply scene.ply
    """
    from clplen.io import write_intrinsics
    from clplen.io.lightfields.lightfield_files import files_of, kind_of
    from clplen.lightfield.metric.board_corners import checked_board, opencv
    from clplen.lightfield.metric.camera_calibration import calibrate as calibrated

    check_suffix(output, (".json",))
    checked_board(board)
    try:
        opencv()
    except ModuleNotFoundError as error:
        raise click.ClickException(str(error)) from error
    for source in sources:
        kind_of(source)  # reports missing files before any file is read
    inputs = [file for source in sources for file in files_of(source, **layout)]
    check_output(output, layout["force"], inputs, " of the light fields")
    with progress_bar(len(sources), "board") as bar:
        lazy = _LightFields(sources, selector, layout, bar)
        intrinsics = calibrated(lazy, board, spacing, names=[str(source) for source in sources])
    write_intrinsics(output, intrinsics)
    for line in summary(intrinsics, [str(source) for source in sources]):
        click.echo(line)
    click.echo(f"{output} holds the intrinsics; pass it to other commands as --intrinsics.")


class _LightFields(Sequence["LightField"]):
    """Sequence of light fields that are read on access."""

    def __init__(
        self, sources: tuple[Path, ...], selector: str | None, layout: dict[str, Any], bar: Any
    ) -> None:
        self.sources, self.selector, self.layout, self.bar = sources, selector, layout, bar

    def __len__(self) -> int:
        return len(self.sources)

    def __getitem__(self, index: Any) -> Any:
        advance(self.bar, self.sources[index].name)
        return read(self.sources[index], self.selector, self.layout)


def summary(intrinsics: Intrinsics, names: list[str]) -> list[str]:
    """Return the intrinsics as lines of text."""
    H, (b_u, b_v, k1, k2, k3) = intrinsics.matrix, intrinsics.distortion
    f_y, f_x = intrinsics.focal
    y, x = _axis(intrinsics)
    D = np.zeros((5, 5)) if intrinsics.deviations is None else intrinsics.deviations
    V, U, ny, nx = intrinsics.shape
    wide = [2 * np.degrees(np.arctan(n * pitch / 2)) for n, pitch in ((nx, H[2, 2]), (ny, H[3, 3]))]
    inverse = 1 / intrinsics.focus
    far = f"{intrinsics.focus:.4g} m" if inverse else "infinity"
    lines = [
        f"views          {V} x {U} of {ny} x {nx} pixels, {wide[0]:.3g} x {wide[1]:.3g} degrees",
        f"focal length   {f_x:.6g} px along x (+- {f_x**2 * D[2, 2]:.2g}), {f_y:.6g} px along y "
        f"(+- {f_y**2 * D[3, 3]:.2g})",
        f"baseline       {H[0, 0]:.5g} m between columns of views (+- {D[0, 0]:.2g}), "
        f"{H[1, 1]:.5g} m between rows (+- {D[1, 1]:.2g})",
        f"disparity 0    at {far}",
        f"axis           at pixel (y, x) = ({y:.2f}, {x:.2f}) of the middle view",
        f"distortion     k1 {k1:.4g}, k2 {k2:.4g}, k3 {k3:.4g} about ({b_u:.3g}, {b_v:.3g})",
        f"rms            {intrinsics.rms:.3g} px",
    ]
    rms = intrinsics.board_rms
    if rms is not None:
        worst = int(np.nanargmax(rms))
        each = ", ".join("left out" if np.isnan(value) else f"{value:.3g}" for value in rms)
        lines.append(f"  of boards    {each}")
        if rms[worst] > _OUTLIER_RATIO * np.nanmedian(rms):
            lines.append(f"               largest: {names[worst]}")
    if intrinsics.view_rms is not None:
        low, high = np.nanmin(intrinsics.view_rms), np.nanmax(intrinsics.view_rms)
        lines.append(f"  of views     {low:.3g} to {high:.3g}")
    return lines


def _axis(intrinsics: Intrinsics) -> tuple[float, float]:
    """Return the pixel (y, x) of the middle view on the optical axis."""
    V, U = intrinsics.shape[:2]
    H = intrinsics.matrix
    x = -(H[2, 4] + H[2, 0] * (U - 1) / 2) / H[2, 2]
    y = -(H[3, 4] + H[3, 1] * (V - 1) / 2) / H[3, 3]
    return float(y), float(x)
