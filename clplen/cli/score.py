"""``clplen score``."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from clplen.cli.shared import options

# Masks of the HCI 4D benchmark, by the name of the score.
_MASKS = {"planes": "planes", "smooth": "smooth_surfaces", "near": "fine",
          "far": "fine_surrounding", "edges": "discontinuities"}  # fmt: skip
_LOW = "lowres"


@click.command()
@click.argument("result", metavar="RESULT", type=click.Path(path_type=Path))
@click.argument("truth", metavar="TRUTH", type=click.Path(path_type=Path))
@options.file("--mask", help="Picture of the size of TRUTH; black pixels are ignored.")
@click.option(
    "--border",
    type=click.IntRange(min=0),
    default=15,
    show_default=True,
    help="Width of the border of TRUTH that is ignored, in pixels.",
)
@click.option(
    "--offset",
    nargs=2,
    type=click.IntRange(min=0),
    default=None,
    metavar="Y X",
    help="Position in TRUTH of the first pixel of a cropped RESULT.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON; unknown values are null.")
def score(
    result: Path,
    truth: Path,
    mask: Path | None,
    border: int,
    offset: tuple[int, int] | None,
    as_json: bool,
) -> None:
    """Score a disparity map against the true one.

    The scores are those of the HCI benchmark. Both maps are PFM, TIFF of floats or .npy. 8-bit
    pictures are rejected, since the scale of their levels is unknown. The masks
    (mask_planes_lowres.png, ...) and parameters.cfg of the benchmark are used if they lie in the
    folder of TRUTH.

    \b
    Example:
      clplen score cotton.pfm training/cotton/gt_disp_lowres.pfm
    """
    from clplen.analysis.quality import score as judge
    from clplen.errors import FormatError
    from clplen.io import read_disparity

    estimate, reference = read_disparity(result), read_disparity(truth)
    if offset is None and estimate.shape != reference.shape:
        sizes = [f"{ny} x {nx}" for ny, nx in (estimate.shape, reference.shape)]
        raise FormatError(
            f"{result} has {sizes[0]} pixels (y, x), {truth} {sizes[1]}: give --offset Y X, the "
            "position of the first pixel of a cropped map; do not resize it."
        )
    masks, parameters = _benchmark_files(truth, reference.shape)
    scores = judge(
        estimate,
        reference,
        masks=masks,
        where=None if mask is None else _mask(mask, reference.shape),
        border=border,
        offset=offset,
        parameters=parameters,
    )
    if as_json:
        values = {name: _plain(value) for name, value in asdict(scores).items()}
        click.echo(json.dumps(values, indent=2))
    else:
        click.echo(scores)


def _plain(value: float) -> float | str | None:
    """Convert a number for JSON; NaN becomes null."""
    if math.isfinite(value):
        return value
    return None if math.isnan(value) else "infinite"


def _mask(path: Path, shape: tuple[int, ...]) -> Any:
    """Return a mask of the pixels of a picture that are not black."""
    from clplen.errors import FormatError
    from clplen.io.formats.picture import read_picture

    values = read_picture(path)
    lit = values.reshape(*values.shape[:2], -1)[..., :3].any(axis=2)
    if lit.shape != tuple(shape):
        raise FormatError(
            f"{path} has {lit.shape[0]} x {lit.shape[1]} pixels (y, x), but the true disparity has "
            f"{shape[0]} x {shape[1]}."
        )
    return lit


def _benchmark_files(truth: Path, shape: tuple[int, ...]) -> tuple[dict[str, Any], Any]:
    """Read the masks and parameters of the benchmark in the folder of the true map."""
    from clplen.io import read_parameters

    if _LOW not in truth.name:
        return {}, None
    files = {name: truth.parent / f"mask_{word}_{_LOW}.png" for name, word in _MASKS.items()}
    masks = {name: _mask(file, shape) for name, file in files.items() if file.is_file()}
    has_parameters = (truth.parent / "parameters.cfg").is_file()
    return masks, read_parameters(truth.parent) if has_parameters else None
