"""``clplen score``."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from clplen.cli.shared import options

# Masks of the HCI 4D benchmark beside a true disparity, and what they are here.
_MASKS = {"planes": "planes", "smooth": "smooth_surfaces", "near": "fine",
          "far": "fine_surrounding", "edges": "discontinuities"}  # fmt: skip
_LOW = "lowres"


@click.command()
@click.argument("result", metavar="RESULT", type=click.Path(path_type=Path))
@click.argument("truth", metavar="TRUTH", type=click.Path(path_type=Path))
@options.file("--mask", help="A picture of the truth's size: judge only where it is not black.")
@click.option(
    "--border",
    type=click.IntRange(min=0),
    default=15,
    show_default=True,
    help="Pixels of the truth that are left out on each side.",
)
@click.option(
    "--offset",
    nargs=2,
    type=click.IntRange(min=0),
    default=None,
    metavar="Y X",
    help="Place in TRUTH of the first pixel of a cropped RESULT.",
)
@click.option("--json", "as_json", is_flag=True, help="Write JSON; what is not known is null.")
def score(
    result: Path,
    truth: Path,
    mask: Path | None,
    border: int,
    offset: tuple[int, int] | None,
    as_json: bool,
) -> None:
    """Judge a disparity map against the true one, as the HCI benchmark does.

    Both are PFM, TIFF of floats or .npy: 8-bit pictures do not say what their levels mean. Masks
    (mask_planes_lowres.png, ...) and parameters.cfg of the benchmark are used where they lie beside
    TRUTH.

    \b
    Example:
      clplen score cotton.pfm training/cotton/gt_disp_lowres.pfm
    """
    from clplen.analysis.quality import score as judge
    from clplen.errors import FormatError
    from clplen.io import read_disparity

    found, known = read_disparity(result), read_disparity(truth)
    if offset is None and found.shape != known.shape:
        sizes = [f"{ny} x {nx}" for ny, nx in (found.shape, known.shape)]
        raise FormatError(
            f"{result} has {sizes[0]} pixels (y, x), {truth} {sizes[1]}: say by --offset where the "
            "first pixel of a cropped map lies; do not resize it."
        )
    masks, parameters = _beside(truth, known.shape)
    scores = judge(
        found,
        known,
        masks=masks,
        where=None if mask is None else _picture(mask, known.shape),
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
    """What JSON has for a number; null for nan."""
    if math.isfinite(value):
        return value
    return None if math.isnan(value) else "infinite"


def _picture(path: Path, shape: tuple[int, ...]) -> Any:
    """Where a picture is not black."""
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


def _beside(truth: Path, shape: tuple[int, ...]) -> tuple[dict[str, Any], Any]:
    """Masks and parameters of the benchmark in the folder of its truth."""
    from clplen.io import read_parameters

    if _LOW not in truth.name:
        return {}, None
    files = {name: truth.parent / f"mask_{word}_{_LOW}.png" for name, word in _MASKS.items()}
    masks = {name: _picture(file, shape) for name, file in files.items() if file.is_file()}
    there = (truth.parent / "parameters.cfg").is_file()
    return masks, read_parameters(truth.parent) if there else None
