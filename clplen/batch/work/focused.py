"""What is made of a simulated raw image of a focused (plenoptic 2.0) camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen import io
from clplen.cameras.plenoptic2 import Plenoptic2
from clplen.lightfield.focused import focused_stack, render_focused
from clplen.lightfield.focused_depth import focused_depth
from clplen.lightfield.focused_maps import focused_maps

if TYPE_CHECKING:
    from clplen.lightfield.raw import RawImage

Written = tuple[str, Callable[[Path], Any]]

_NONE = {
    "views": "has no views of directions: leave [views] out",
    "light_field": "has no light field, its raw.h5 is written: leave [light_field] out",
}


def is_focused(raw: Any) -> bool:
    """Whether a raw image is of a focused camera."""
    return raw is not None and isinstance(raw.camera, Plenoptic2)


def focused_products(
    raw: RawImage, work: dict[str, Any], suffixes: dict[str, str]
) -> Iterator[Written]:
    """Names and writers: raw.h5 always, stack, depth and all_in_focus where they are asked for.

    Parameters
    ----------
    raw : RawImage
        Of a `Plenoptic2`.
    work : dict
        The job's tables; [stack] needs ``alphas``, the planes F/F'.
    suffixes : dict
        Of the formats.

    Raises
    ------
    ValueError
        For a table that makes no sense here, or depth that cannot be told.
    """
    for name, why in _NONE.items():
        if name in work:
            raise ValueError(f"A focused camera {why}.")
    endings = [suffixes[name] for name in work["formats"]]
    yield "raw.h5", lambda path: io.write_raw(path, raw, durable=True)
    if "stack" in work:
        stack = focused_stack(raw, ms=_ms(raw, work["stack"]))
        for ending in endings:
            yield f"stack{ending}", _writer(io.write_focused, stack)
    if "depth" not in work and "all_in_focus" not in work:
        return
    depth = focused_depth(raw)
    if "depth" in work:
        maps = focused_maps(raw, depth)
        for ending in endings:
            yield f"depth{ending}", _writer(io.write_focused_depth, depth, maps)
    if "all_in_focus" in work:
        picture = render_focused(raw, method="depth", depth=depth)
        for ending in endings:
            yield f"all_in_focus{ending}", _writer(io.write_focused, picture)


def _writer(write: Callable[..., None], *made: Any) -> Callable[[Path], Any]:
    def put(path: Path) -> None:
        write(path, *made, durable=True, replace=True)

    return put


def _ms(raw: RawImage, table: dict[str, Any]) -> np.ndarray[Any, Any]:
    """m = b/(z2 - F/alpha) of the planes."""
    camera: Any = raw.camera
    if "alphas" not in table:
        raise ValueError(
            "The planes of a focused camera have no disparities: give alphas in [stack], F/F' as "
            "for other cameras."
        )
    alphas = np.asarray(table["alphas"], np.float64)
    return np.asarray(
        camera.sensor_distance / (camera.array_distance - camera.image_distance / alphas)
    )
