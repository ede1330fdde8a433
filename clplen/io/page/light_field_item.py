"""Light fields as items of a page: views, laws of focus and aperture, depth, raw image."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.checks import is_integer
from clplen.compute.device import DeviceLike
from clplen.errors import ShapeError
from clplen.io.formats.animation import white_level
from clplen.io.page.samples import Array, Content, Levels, downscaled, jpeg, packed_floats, png
from clplen.lightfield.depth.best_focus import default_disparities
from clplen.lightfield.depth.depth_maps import DepthMap, sharpness_curve
from clplen.lightfield.model.alpha_law import depth_at, unit_steps
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.raw.raw_image import RawImage, is_telecentric
from clplen.lightfield.stacks import focal_stack

_RANGE = (2.0, 98.0)  # percentiles of disparity at the ends of the colour table
_MIN_CONFIDENCE = 0.5  # of disparities used for the range
_FOCUS_MARGIN = 0.5  # of the disparity range, added at both ends for focusing
_PLANES = 33  # planes searched for the initial focus
_RAW_QUALITY = 90  # JPEG quality of a large raw image
_MAX_PNG_PIXELS = 2_000_000  # larger raw images are JPEG
_MAX_DISTANCE = 1e9  # metres; larger object distances are infinite


@dataclass(frozen=True)
class PageOptions:
    """Options for light fields in a page."""

    quality: int | None = None  # JPEG quality, 1 to 100; None for lossless
    downscale: int = 1  # pixels averaged along each axis
    views: tuple[int, int] | None = None  # largest number of central views (V, U)

    def __post_init__(self) -> None:
        if self.quality is not None and not 1 <= self.quality <= 100:
            raise ValueError(f"quality must be 1 to 100, got {self.quality!r}.")
        if not is_integer(self.downscale) or self.downscale < 1:
            raise ValueError(f"downscale must be a positive integer, got {self.downscale!r}.")
        if self.views is not None and min(self.views) < 1:
            raise ValueError(f"views must be at least 1 x 1, got {self.views!r}.")


def light_field_item(
    lf: LightField | StoredLightField,
    content: Content,
    *,
    name: str,
    options: PageOptions,
    depth: DepthMap | None = None,
    depth_file: str | None = None,
    srgb: bool = False,
    device: DeviceLike | None = None,
) -> dict[str, Any]:
    """Add a light field to a page, and return its description."""
    if lf.shape[4:] not in ((), (1,), (3,)):
        raise ShapeError(
            f"A light field must have one or three channels for a page, got {lf.shape[4]}: select "
            "channels with clplen.LightField in Python."
        )
    rows, columns = _central_views(lf.shape[:2], options.views)
    reduced = reduced_light_field(lf, rows, columns, options.downscale, device)
    channels = (3,) if lf.shape[4:] == (3,) else ()
    V, U, ny, nx = reduced.shape[:4]
    samples = reduced.to_numpy().reshape(V * U, ny, nx, *channels)
    focus, span = _focus(reduced, depth, options.downscale)
    raw = lf.raw if isinstance(lf, LightField) else None
    dy, dx = (math.nan, math.nan) if reduced.spacing is None else reduced.spacing[2:]
    has_pixel = np.isfinite([dy, dx]).all()
    n = options.downscale
    return {
        "kind": "light field",
        "name": name,
        "shape": [V, U, ny, nx, *channels],
        "samples": _samples(samples, content, options.quality),
        "weights": [float(w) for w in reduced.weights.ravel()],
        "steps": [[float(y), float(x)] for y, x in unit_steps(reduced).reshape(-1, 2)],
        "focus": focus,
        "range": list(span),
        "alpha": _alpha(reduced),
        "metres": _metres(reduced, span),
        "f_number": _f_number(reduced, U),
        "pixel": [abs(dy), abs(dx)] if has_pixel else None,
        "shown": _display_range(samples, srgb),
        "depth": None if depth is None else depth_item(depth, content, n, depth_file),
        "raw": None if raw is None else _raw(raw, content),
        "full": {
            "views": list(lf.shape[:2]),
            "first": [int(rows.start), int(columns.start)],
            "downscale": n,
        },
    }


def reduced_light_field(
    lf: LightField | StoredLightField,
    rows: slice,
    columns: slice,
    n: int,
    device: DeviceLike | None = None,
) -> LightField:
    """Return some of the views, averaged over n x n pixels, as a light field."""
    ny, nx = (size // n for size in lf.shape[2:4])
    if min(ny, nx) < 1:
        raise ShapeError(
            f"downscale must be at most the {lf.shape[2]} x {lf.shape[3]} pixels of a view, got "
            f"{n}."
        )
    is_unchanged = (rows.stop - rows.start, columns.stop - columns.start) == lf.shape[:2] and n == 1
    if isinstance(lf, LightField):
        if is_unchanged:
            return lf
        device = lf.device
    read: Any = lf.to_numpy().__getitem__ if isinstance(lf, LightField) else lf.read
    shape = (rows.stop - rows.start, columns.stop - columns.start, ny, nx, *lf.shape[4:])
    out = np.empty(shape, lf.dtype)
    for v in range(shape[0]):
        for u in range(shape[1]):
            at = (rows.start + v, columns.start + u)
            block = (slice(at[0], at[0] + 1), slice(at[1], at[1] + 1), slice(None), slice(None))
            out[v, u] = downscaled(read(block)[0, 0], n)
    spacing = lf.spacing
    if spacing is not None:
        spacing = (*spacing[:2], spacing[2] * n, spacing[3] * n)
    positions = None if lf.positions is None else lf.positions[rows, columns]
    result = LightField.from_array(
        out,
        device=device,
        spacing=spacing,
        weights=lf.weights[rows, columns],
        camera=lf.camera,
        positions=positions,
    )
    return replace(result, decode=lf.decode, parametrisation=lf.parametrisation)


def depth_item(
    depth: DepthMap, content: Content, n: int = 1, file: str | None = None
) -> dict[str, Any]:
    """Add a depth map, with disparities of every n-th pixel, and return its description."""
    disparity = depth.disparity / n
    if n > 1:
        disparity = disparity[n // 2 :: n, n // 2 :: n][
            : depth.disparity.shape[0] // n, : depth.disparity.shape[1] // n
        ]
    low, high = (end / n for end in _span(depth))
    return {
        "disparity": map_item(disparity, content),
        "range": [low, high if high > low else low + 1e-3],
        "file": file,
    }


def map_item(values: Array, content: Content) -> dict[str, Any]:
    """Add a map of floats to a page, and return its description."""
    return {"shape": list(values.shape), "blob": content.add(lambda: packed_floats(values))}


def _central_views(views: tuple[int, ...], limits: tuple[int, int] | None) -> tuple[slice, slice]:
    """Return rows and columns about the centre; the parity of the counts is kept."""
    slices = []
    for n, limit in zip(views, limits or views, strict=True):
        count = min(limit, n)
        count -= (n - count) % 2 and count > 1
        slices.append(slice((n - count) // 2, (n - count) // 2 + count))
    return slices[0], slices[1]


def _samples(samples: Array, content: Content, quality: int | None) -> dict[str, Any]:
    """Add all views to a page, and return their type and levels."""
    eight = samples.dtype == np.uint8
    if not eight and quality is None:
        levels = Levels.of(samples)
        blobs = [content.add(lambda view=view: levels.packed(view)) for view in samples]  # type: ignore[misc]
        return {"type": "uint16", "low": levels.low, "step": levels.step, "blobs": blobs}
    levels = Levels(0.0, 1.0) if eight else Levels.of(samples, 255)

    def picture(view: Array) -> bytes:
        pixels = view if eight else np.rint((view - levels.low) / levels.step).astype(np.uint8)
        return png(pixels) if quality is None else jpeg(pixels, quality)

    blobs = [content.add(lambda view=view: picture(view)) for view in samples]  # type: ignore[misc]
    return {"type": "uint8", "low": levels.low, "step": 255 * levels.step, "blobs": blobs}


def _display_range(samples: Array, srgb: bool) -> dict[str, Any]:
    """Return initial black, white and curve, and the range of both."""
    central_view = samples[len(samples) // 2]
    white = float(f"{white_level(central_view, samples.dtype, srgb=srgb):.4g}")
    high = 255.0 if samples.dtype == np.uint8 else max(float(samples.max()), white)
    low = min(0.0, float(samples.min()))
    curve = "srgb" if srgb else "linear"
    return {"black": 0.0, "white": white, "curve": curve, "range": [low, high]}


def _span(depth: DepthMap) -> tuple[float, float]:
    """Return the range of nearly all reliable disparities."""
    is_finite = np.isfinite(depth.disparity)
    is_reliable = is_finite & (depth.confidence > _MIN_CONFIDENCE)
    values = depth.disparity[is_reliable if is_reliable.sum() > 100 else is_finite]
    if values.size == 0:
        return 0.0, 0.0
    low, high = np.percentile(values, _RANGE)
    return float(low), float(high)


def _focus(lf: LightField, depth: DepthMap | None, n: int) -> tuple[float, tuple[float, float]]:
    """Return the initial disparity and the range of focus; ``depth`` is of the unreduced views."""
    planes = np.asarray(default_disparities(lf), np.float64)
    if depth is not None:
        low, high = (end / n for end in _span(depth))
        margin = _FOCUS_MARGIN * max(high - low, 0.1)
        reliable = depth.disparity[
            np.isfinite(depth.disparity) & (depth.confidence > _MIN_CONFIDENCE)
        ]
        focus = float(np.median(reliable)) / n if reliable.size else 0.0
        return focus, (min(low - margin, 0.0), max(high + margin, 0.0))
    ends = (float(planes.min()), float(planes.max()))
    if np.count_nonzero(lf.weights) < 2:
        return 0.0, ends
    candidates = np.linspace(*ends, _PLANES)
    stack = focal_stack(lf, disparities=candidates)
    return float(candidates[int(sharpness_curve(stack).argmax())]), ends


def _alpha(lf: LightField) -> dict[str, Any] | None:
    """Return the law of alpha: du/dx, and True for naive cells."""
    if lf.spacing is None or is_telecentric(lf) or not np.isfinite(lf.alpha(0.0)):
        return None
    return {"ratio": lf.spacing[1] / lf.spacing[3], "inverse": lf.decode == "naive"}


def _metres(lf: LightField, span: tuple[float, float]) -> dict[str, Any] | None:
    """Return z(d): 1/(offset + slope d) - object by the lens law, or slope d if telecentric."""
    ends = np.array([0.0, 0.25 * span[1] or 0.25 * span[0] or 0.1])
    z = np.asarray(depth_at(lf, ends), np.float64)
    if not np.isfinite(z).all():
        return None
    if is_telecentric(lf):
        return {"linear": True, "slope": float(z[1] / ends[1])}
    distance = getattr(lf.camera, "object_distance", None)
    if distance is None or not 0 < distance < _MAX_DISTANCE:
        return None
    inverse = 1 / (z + distance)
    slope = (inverse[1] - inverse[0]) / ends[1]
    third = -0.5 * ends[1]
    predicted = 1 / (inverse[0] + slope * third) - distance
    if not math.isclose(
        predicted, float(depth_at(lf, third)), rel_tol=1e-6, abs_tol=1e-9 * distance
    ):
        return None
    law = {"offset": float(inverse[0]), "slope": float(slope), "object": float(distance)}
    return {"linear": False, **law}


def _f_number(lf: LightField, across: int) -> float | None:
    """Return the f-number of the full width of the light field, at the image."""
    if lf.camera is None or lf.spacing is None or is_telecentric(lf):
        return None
    width = abs(lf.spacing[1]) * across
    return float(lf.camera.image_distance / width) if np.isfinite(width) and width > 0 else None


def _raw(raw: RawImage, content: Content) -> dict[str, Any]:
    """Add the raw image in 8 bits, and return its size and lenslets."""
    values = raw.to_numpy()
    white = white_level(values, np.dtype(np.float32))
    eight = np.rint(255 * np.clip(values / white, 0, 1)).astype(np.uint8)
    large = values.size > _MAX_PNG_PIXELS
    blob = content.add(lambda: jpeg(eight, _RAW_QUALITY) if large else png(eight))
    grid = raw.sub_images
    lattice = None
    if not grid.exchanged:
        lattice = {
            "origin": list(grid.first),
            "rows": list(grid.row_step),
            "columns": list(grid.column_step),
            "count": list(grid.count),
            "hexagonal": grid.odd_row_shift != 0,
            "pitch": math.hypot(*grid.column_step),
        }
    return {"blob": blob, "shape": list(raw.shape), "lattice": lattice}
