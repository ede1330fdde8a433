"""Decode raw lenslet frames to light fields.

The lattice is estimated from a white image or the frame, or read from a file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError, SamplingWarning, argument, warn_caller
from clplen.files import PathLike, naming
from clplen.io.formats.picture import linear
from clplen.io.formats.untrusted import require_room
from clplen.io.lightfields.layout import Layout
from clplen.io.lightfields.view_positions import positions_of
from clplen.io.raw.lattice_cache import cached_lattice
from clplen.io.raw.raw_files import read_companion, read_lattice, require_decoding
from clplen.io.raw.sensor_tiff import sensor_tags
from clplen.lightfield.calibration.lattice_fit import visible_lattice
from clplen.lightfield.calibration.lattice_trust import (
    lattice_of_white,
    require_trust,
    rms_apart,
)
from clplen.lightfield.calibration.picture_flat import flat_of_picture
from clplen.lightfield.calibration.raw_decoding import decode_raw, decoding_bytes
from clplen.lightfield.calibration.sensor_frames import subtract_dark
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.lenslet_lattice import Lattice

Frame = np.ndarray[Any, Any]

_MAX_PITCH_ERROR = 0.05  # relative difference of the estimated pitch and that of the metadata
_BRIGHT_PERCENTILE = 99  # of the pixels
_MAX_DARK_RATIO = 0.99  # mean of an exchanged frame relative to the dark frame's mean
_MAX_LATTICE_RMS = 0.15  # pitches between the lattices of grid= and white=

_FRAME_LATTICE = "of the picture itself, without a white image"


@dataclass(frozen=True)
class Capture:
    """Properties of the sensor stored in a file, used unless the user sets them."""

    bayer: str | tuple[tuple[str, ...], ...] | None = None  # colour filters
    # Black level of every pixel of the frame, and of the white image if white_black is None
    black: Frame | None = None
    white_black: Frame | None = None  # black level of the white image
    balance: tuple[float, float, float] | None = None  # factors of red, green and blue
    matrix: Frame | None = None  # colour matrix, shape (3, 3), applied to balanced colours
    # Digital numbers from black to white; the light field is divided by it to linear light.
    span: float | None = None
    pitch: float | None = None  # distance of neighbouring lenslets in pixels
    pixel_pitch: float | None = None  # in metres
    white: Frame | None = None  # white image, with its name in layout.white

    def factors(self) -> tuple[float, float, float] | None:
        """Return factors of red, green and blue for white balance and a white level of 1."""
        if self.balance is None and self.span is None:
            return None
        red, green, blue = self.balance or (1.0, 1.0, 1.0)
        span = self.span or 1.0
        return red / span, green / span, blue / span


def decode_frame(
    frame: Frame,
    path: PathLike,
    *,
    device: Device,
    layout: Layout,
    progress: bool = False,
    capture: Capture | None = None,
) -> tuple[LightField, str]:
    """Decode a raw frame with the given layout options.

    The lattice is that of ``grid=``, else of the white image, else of the frame itself, if it is
    reliable thanks to even light and a plain object (fluorescence microscopy).
    """
    path = Path(path)
    require_decoding(frame.size, path, layout.max_bytes)
    if frame.ndim != 2:
        raise FormatError(
            f"A raw lenslet image must have one channel, got shape {frame.shape} from {path}."
        )
    if layout.order is not None:
        raise ValueError(f"{argument('order')} does not apply to a raw lenslet image.")
    shape = (int(frame.shape[0]), int(frame.shape[1]))
    frame = linear(frame) if layout.srgb else frame
    capture = _capture_of_tiff(path, shape) if capture is None else capture
    white = capture.white
    if white is None:
        white = _companion(layout.white, "white image", frame, path, layout)
    dark = _companion(layout.dark, "dark frame", frame, path, layout)
    _check_roles(frame, white, dark, path, layout)
    layout = replace(layout, bayer=layout.bayer or capture.bayer)
    if dark is None:
        dark = capture.black
        if white is not None and capture.white_black is not None and dark is not None:
            white = subtract_dark(white, capture.white_black) + dark
    lattice, origin = _lattice(frame, white, dark, path, layout, capture.pitch)
    if white is None and origin == _FRAME_LATTICE and layout.devignette is not False:
        white = flat_of_picture(frame, lattice, dark=dark, bayer=layout.bayer)
        origin += (
            ", too dark to estimate the vignetting"
            if white is None
            else ", also used for the vignetting"
        )
    with naming(path):
        _require_views(lattice, path, layout, has_white=white is not None)
        lf = decode_raw(
            frame,
            lattice,
            device=device,
            white=white,
            dark=dark,
            views=layout.views,
            step=layout.step,
            devignette=layout.devignette,
            bayer=layout.bayer,
            demosaic=layout.demosaic or "within",
            white_balance=capture.factors() if layout.bayer else None,
            colour_matrix=capture.matrix if layout.bayer else None,
            pixel_pitch=capture.pixel_pitch,
        )
        lf = _oriented(lf, layout)
    if layout.bayer and capture.span is not None:
        lf = replace(lf, linear=True)
    return lf, _summary(lf, path, lattice, origin, layout)


def _require_views(lattice: Lattice, path: Path, layout: Layout, *, has_white: bool) -> None:
    """Raise FormatError if decoding would exceed the allowed memory."""
    grid = lattice.grid(layout.views or lattice.views(), step=layout.step, square=True)
    nbytes = decoding_bytes(
        grid, bayer=layout.bayer, demosaic=layout.demosaic or "within", has_white=has_white
    )
    what = f"decoding {' x '.join(map(str, grid.shape))} samples"
    require_room(nbytes, path=path, what=what, max_bytes=layout.max_bytes)


def _capture_of_tiff(path: Path, shape: tuple[int, int]) -> Capture:
    """Return the sensor properties in the tags of a TIFF."""
    tags = sensor_tags(path)
    if tags is None:
        return Capture()
    return Capture(bayer=tags.bayer, black=tags.black_frame(shape), balance=tags.balance())


def _companion(
    source: PathLike | None, what: str, frame: Frame, path: Path, layout: Layout
) -> Frame | None:
    """Read a picture that belongs to the frame."""
    if source is None:
        return None
    picture, _ = read_companion(source, what, frame, path, max_bytes=layout.max_bytes)
    return linear(picture) if layout.srgb else picture


def _check_roles(
    frame: Frame, white: Frame | None, dark: Frame | None, path: Path, layout: Layout
) -> None:
    """Raise FormatError for exchanged pictures, if their brightness is unambiguous.

    Frames without light may be slightly darker: the limit is 1 % in mean and peak.
    """
    if white is not None and dark is not None and white.mean() <= dark.mean():
        raise FormatError(
            f"The white image {layout.white} must be brighter than the dark frame {layout.dark}: "
            "check whether they are exchanged."
        )
    if dark is not None and not layout.force:
        if np.array_equal(frame, dark):
            raise FormatError(
                f"The dark frame {layout.dark} is identical to {path}, so no signal is left: give "
                "a dark frame taken without light."
            )
        bright = [np.percentile(picture, _BRIGHT_PERCENTILE) for picture in (frame, dark)]
        if frame.mean() < _MAX_DARK_RATIO * dark.mean() and bright[0] < bright[1]:
            raise FormatError(
                f"{path} is darker than its dark frame {layout.dark}: check whether they are "
                "exchanged."
            )
    if white is not None and np.array_equal(frame, white):
        warn_caller(
            f"{path} and its white image {layout.white} are identical, so all views are 1: give "
            "the frame of a scene.",
            SamplingWarning,
        )


def _lattice(
    frame: Frame,
    white: Frame | None,
    dark: Frame | None,
    path: Path,
    layout: Layout,
    pitch: float | None,
) -> tuple[Lattice, str]:
    """Return the lattice and a text with its origin."""
    is_trusted = layout.force or layout.trust_lattice
    options: dict[str, Any] = {"dark": dark, "bayer": layout.bayer}
    search = {**options, "kind": layout.lattice, "pitch": pitch}
    if layout.grid is not None:
        stored = read_lattice(layout.grid, (int(frame.shape[0]), int(frame.shape[1])))
        if white is not None and layout.white is not None:
            with naming(layout.white):
                _require_same(stored, cached_lattice(white, **search), layout)
        return stored, f"of {layout.grid}"
    if white is not None and layout.white is not None:
        lattice = lattice_of_white(
            white, layout.white, frame=frame, path=path, force=is_trusted, error=FormatError,
            estimate=cached_lattice, **search,
        )  # fmt: skip
        return lattice, f"of the white image {layout.white}"
    with naming(path):
        if pitch is not None:
            visible = visible_lattice(frame, **options)
            if visible is not None and abs(visible.neighbour / pitch - 1) < _MAX_PITCH_ERROR:
                return visible, _FRAME_LATTICE
        lattice = cached_lattice(frame, **search)
    if lattice.trust == "low":
        if not (lattice.is_measured and layout.trust_lattice):
            trust = f", or {argument('trust_lattice', True)} to use the estimated lattice"
            raise FormatError(
                f"The lenslets of {path} are unknown: give {argument('white')}, a white image of "
                f"the same camera, or {argument('grid')}, its lattice"
                f"{trust if lattice.is_measured else ''} ({lattice.verdict})"
            )
        require_trust(lattice, str(path), force=True, error=FormatError)
    return lattice, "of the frame itself, without a white image"


def _require_same(stored: Lattice, estimated: Lattice, layout: Layout) -> None:
    """Raise FormatError if a stored lattice differs from a reliable one of the white image."""
    if estimated.trust == "low":
        return
    distance = rms_apart(stored, estimated)
    if distance > _MAX_LATTICE_RMS * estimated.neighbour or stored.kind != estimated.kind:
        raise FormatError(
            f"{layout.grid} and the white image {layout.white} belong to different cameras: their "
            f"lenslets differ by {distance:.2g} px rms ({estimated.verdict}) Give only one of them."
        )


def _oriented(lf: LightField, layout: Layout) -> LightField:
    """Return the light field with view axes changed by the layout options."""
    positions = positions_of(layout, (lf.shape[0], lf.shape[1]))
    if not (layout.swap_uv or layout.flip_v or layout.flip_u):
        return lf if positions is None else replace(lf, positions=positions)
    data = np.ascontiguousarray(layout.oriented(lf.to_numpy()))
    return LightField.from_array(
        data,
        device=lf.device,
        spacing=lf.spacing,
        weights=layout.oriented(lf.weights),
        positions=positions,
    )


def _summary(lf: LightField, path: Path, lattice: Lattice, origin: str, layout: Layout) -> str:
    V, U, ny, nx = lf.shape[:4]
    colours = " of 3 colours" if len(lf.shape) == 5 else ""
    flat = "divided by the white image" if layout.white and layout.devignette is not False else ""
    parts = [
        f"{V} x {U} views (V x U) of {ny} x {nx} pixels{colours} from {path}",
        flat,
        f"lattice {origin} ({lattice.verdict.rstrip('.')})",
        *layout.view_changes(),
    ]
    return ", ".join(part for part in parts if part)
