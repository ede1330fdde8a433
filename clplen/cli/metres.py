"""From disparity to metres on the command line: lengths of the camera, distances, points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

if TYPE_CHECKING:
    from clplen.lightfield.depth import DepthMap
    from clplen.lightfield.lightfield import LightField

Values = np.ndarray[Any, Any]

_NEEDED = {"baseline_mm": "--baseline-mm", "focal_mm": "--focal-mm", "pixel_um": "--pixel-um"}
_ALSO = {"focus_m": "--focus-m", "metric": "--metric", "ply": "--ply"}

_OPTIONS = (
    click.option(
        "--baseline-mm", type=float, help="Between neighbouring views; with the next two: metres."
    ),
    click.option("--focal-mm", type=float, help="From the lens to the sensor."),
    click.option("--pixel-um", type=float, help="Pitch of the pixels."),
    click.option("--focus-m", type=float, help="Where disparity is 0; default: infinity."),
    click.option(
        "--metric",
        metavar="FILE",
        type=click.Path(path_type=Path),
        help="Distances in metres, as .pfm, .tif or .npy.",
    ),
    click.option(
        "--ply",
        metavar="FILE.ply",
        type=click.Path(path_type=Path),
        help="Points in metres with their colours.",
    ),
)


@dataclass(frozen=True)
class Lengths:
    """Of a camera, in metres: what distances are computed from, and where they go."""

    baseline: float
    focal_length: float
    pixel_pitch: float
    focus_distance: float | None
    metric: Path | None
    ply: Path | None

    @property
    def camera(self) -> dict[str, Any]:
        """The lengths alone, as `metric_depth` and `points_of` take them."""
        return {
            "baseline": self.baseline,
            "focal_length": self.focal_length,
            "pixel_pitch": self.pixel_pitch,
            "focus_distance": self.focus_distance,
        }


def lengths(command: Any) -> Any:
    """The options of metres for a command."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def lengths_of(words: dict[str, Any]) -> Lengths | None:
    """The options of metres, taken out of `words`; None if none is given."""
    names = {**_NEEDED, **_ALSO}
    given = {key: value for key in names if (value := words.pop(key)) is not None}
    if not given:
        return None
    missing = [name for key, name in _NEEDED.items() if key not in given]
    if missing:
        raise click.UsageError(
            f"{' and '.join(names[key] for key in given)} ask for metres, which need "
            f"{', '.join(_NEEDED.values())} too: give {' and '.join(missing)}."
        )
    for key, value in given.items():
        if isinstance(value, float) and not (np.isfinite(value) and value > 0):
            raise click.UsageError(f"{names[key]} is a length, positive and finite, not {value:g}.")
    return Lengths(
        given["baseline_mm"] * 1e-3,
        given["focal_mm"] * 1e-3,
        given["pixel_um"] * 1e-6,
        given.get("focus_m"),
        given.get("metric"),
        given.get("ply"),
    )


def write(lf: LightField, found: DepthMap, lengths: Lengths) -> str:
    """Write distances and points where they are asked for; what to say of them."""
    from clplen.io import points_of, write_ply
    from clplen.lightfield.metric import metric_depth

    Z = metric_depth(found.disparity, **lengths.camera)
    if lengths.metric is not None:
        write_map(lengths.metric, Z.astype(np.float32))
    if lengths.ply is not None:
        points, words = points_of(found.disparity, **lengths.camera)
        write_ply(lengths.ply, points, colours_of(lf), comment=words)
    known = np.isfinite(Z)
    if not known.any():
        return "No pixel lies at a finite distance: check the lengths and --focus-m."
    low, middle, high = np.percentile(Z[known], [5, 50, 95])
    return (
        f"Distances: median {middle:.4g} m, 90 % of them from {low:.4g} to {high:.4g} m; "
        f"{100 * known.mean():.0f} % of the pixels lie at a finite distance."
    )


def write_map(path: Path, values: Values) -> None:
    """A float map (y, x) as PFM, TIFF or NumPy, by its suffix."""
    from clplen.files import replacing
    from clplen.io import write_pfm, write_picture

    if path.suffix.lower() == ".npy":
        with replacing(path) as partial, partial.open("wb") as file:
            np.save(file, values)
    elif path.suffix.lower() == ".pfm":
        write_pfm(path, values)
    else:
        write_picture(path, values)


def colours_of(lf: LightField) -> Values:
    """The centre view as uint8 colours, shape (n, 3); floats by their largest value."""
    V, U = lf.shape[:2]
    picture = lf.view((V - 1) / 2, (U - 1) / 2).to_numpy().astype(np.float64)
    top = np.iinfo(lf.dtype).max if lf.dtype.kind == "u" else max(float(picture.max()), 1e-30)
    grey = picture.reshape(*picture.shape[:2], -1)
    three = grey if grey.shape[2] == 3 else np.repeat(grey[..., :1], 3, axis=2)
    return np.asarray(np.rint(255 * np.clip(three / top, 0, 1)), np.uint8).reshape(-1, 3)
