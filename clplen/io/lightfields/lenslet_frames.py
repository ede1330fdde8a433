"""Raw lenslet frames as light fields.

Their lattice comes from a white image, a file, or themselves.
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

_NEAR = 0.05  # of the pitch that a file tells, by which the lattice of a picture may differ
_BRIGHT = 99  # per cent of the pixels that are darker
_DARKER = 0.99  # of the dark frame's mean
_APART = 0.15  # pitches rms, by which the lattices of grid= and white= may differ

_ITSELF = "of the picture itself, without a white image"


@dataclass(frozen=True)
class Capture:
    """What a file tells of the sensor that took a frame, where the user does not."""

    bayer: str | tuple[tuple[str, ...], ...] | None = None  # colour filters
    # Black level of every pixel of the frame, and of the white image if white_black is None.
    black: Frame | None = None
    white_black: Frame | None = None  # black level of the white image
    balance: tuple[float, float, float] | None = None  # factors of red, green and blue
    matrix: Frame | None = None  # colour matrix, shape (3, 3), applied to balanced colours
    # Numbers from black to white; the light field is divided by it and is linear light then.
    span: float | None = None
    pitch: float | None = None  # distance of neighbouring lenslets in pixels
    pixel_pitch: float | None = None  # in metres
    white: Frame | None = None  # white image; layout.white is its name then

    def factors(self) -> tuple[float, float, float] | None:
        """Factors of red, green and blue that balance them and bring white to 1."""
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
    """Decode a raw frame as the words of layout say.

    The lattice of lenslets is that of ``grid=``, else of the white image, else of the frame itself,
    where even light and a plain object let it be trusted (fluorescence microscopy).
    """
    path = Path(path)
    require_decoding(frame.size, path, layout.max_bytes)
    if frame.ndim != 2:
        raise FormatError(f"{path} has shape {frame.shape}; a raw lenslet image has one channel.")
    if layout.order is not None:
        raise ValueError(f"{argument('order')} does not apply to a raw lenslet image.")
    shape = (int(frame.shape[0]), int(frame.shape[1]))
    frame = linear(frame) if layout.srgb else frame
    capture = _of_tiff(path, shape) if capture is None else capture
    white = capture.white
    if white is None:
        white = _beside(layout.white, "white image", frame, path, layout)
    dark = _beside(layout.dark, "dark frame", frame, path, layout)
    _check_roles(frame, white, dark, path, layout)
    layout = replace(layout, bayer=layout.bayer or capture.bayer)
    if dark is None:
        dark = capture.black
        if white is not None and capture.white_black is not None and dark is not None:
            white = subtract_dark(white, capture.white_black) + dark
    lattice, whence = _lattice(frame, white, dark, path, layout, capture.pitch)
    if white is None and whence == _ITSELF and layout.devignette is not False:
        white = flat_of_picture(frame, lattice, dark=dark, bayer=layout.bayer)
        whence += (
            ", which is too dark to tell their vignetting"
            if white is None
            else ", and their vignetting from it"
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
    return lf, _sentence(lf, path, lattice, whence, layout)


def _require_views(lattice: Lattice, path: Path, layout: Layout, *, has_white: bool) -> None:
    """Refuse a light field that decoding could not hold in the memory allowed."""
    grid = lattice.grid(layout.views or lattice.views(), step=layout.step, square=True)
    nbytes = decoding_bytes(
        grid, bayer=layout.bayer, demosaic=layout.demosaic or "within", has_white=has_white
    )
    what = f"decoding {' x '.join(map(str, grid.shape))} samples"
    require_room(nbytes, path=path, what=what, max_bytes=layout.max_bytes)


def _of_tiff(path: Path, shape: tuple[int, int]) -> Capture:
    """What the tags of a TIFF tell."""
    tags = sensor_tags(path)
    if tags is None:
        return Capture()
    return Capture(bayer=tags.bayer, black=tags.black_frame(shape), balance=tags.balance())


def _beside(
    source: PathLike | None, what: str, frame: Frame, path: Path, layout: Layout
) -> Frame | None:
    """A picture that belongs to the frame."""
    if source is None:
        return None
    picture, _ = read_companion(source, what, frame, path, max_bytes=layout.max_bytes)
    return linear(picture) if layout.srgb else picture


def _check_roles(
    frame: Frame, white: Frame | None, dark: Frame | None, path: Path, layout: Layout
) -> None:
    """Refuse pictures that stand in for one another, where their brightness leaves no doubt.

    A frame without any light, or of which a drifting offset left a little less than the dark frame,
    is none of them: it must be darker in the mean by 1 % and in its brightest 1 % of pixels.
    """
    if white is not None and dark is not None and white.mean() <= dark.mean():
        raise FormatError(
            f"The white image {layout.white} is no brighter than the dark frame {layout.dark}: are "
            "they exchanged?"
        )
    if dark is not None and not layout.force:
        if np.array_equal(frame, dark):
            raise FormatError(
                f"The dark frame {layout.dark} is the same picture as {path}, so that nothing is "
                "left: give a dark frame, taken without light."
            )
        bright = [np.percentile(picture, _BRIGHT) for picture in (frame, dark)]
        if frame.mean() < _DARKER * dark.mean() and bright[0] < bright[1]:
            raise FormatError(
                f"{path} is darker than its dark frame {layout.dark}: are they exchanged?"
            )
    if white is not None and np.array_equal(frame, white):
        warn_caller(
            f"{path} and its white image {layout.white} are the same picture, so that the views "
            "show nothing but 1: give the frame of a scene.",
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
    """Return the lattice and where it comes from."""
    trusted = layout.force or layout.trust_lattice
    words: dict[str, Any] = {"dark": dark, "bayer": layout.bayer}
    search = {**words, "kind": layout.lattice, "pitch": pitch}
    if layout.grid is not None:
        given = read_lattice(layout.grid, (int(frame.shape[0]), int(frame.shape[1])))
        if white is not None and layout.white is not None:
            with naming(layout.white):
                _require_same(given, cached_lattice(white, **search), layout)
        return given, f"of {layout.grid}"
    if white is not None and layout.white is not None:
        found = lattice_of_white(
            white, layout.white, frame=frame, path=path, force=trusted, error=FormatError,
            estimate=cached_lattice, **search,
        )  # fmt: skip
        return found, f"of the white image {layout.white}"
    with naming(path):
        if pitch is not None:
            seen = visible_lattice(frame, **words)
            if seen is not None and abs(seen.neighbour / pitch - 1) < _NEAR:
                return seen, _ITSELF
        found = cached_lattice(frame, **search)
    if found.trust == "low":
        if not (found.is_measured and layout.trust_lattice):
            trust = f", or {argument('trust_lattice', True)} to take what was found"
            raise FormatError(
                f"{path} does not tell where its lenslets are: give {argument('white')}, a white "
                f"image of the same camera, or {argument('grid')}, its lattice"
                f"{trust if found.is_measured else ''} ({found.verdict})"
            )
        require_trust(found, str(path), force=True, error=FormatError)
    return found, "of the frame itself, without a white image"


def _require_same(given: Lattice, found: Lattice, layout: Layout) -> None:
    """Refuse a lattice of a file beside that of the white image, if that can be trusted."""
    if found.trust == "low":
        return
    off = rms_apart(given, found)
    if off > _APART * found.neighbour or given.kind != found.kind:
        raise FormatError(
            f"{layout.grid} and the white image {layout.white} are of different cameras: their "
            f"lenslets lie {off:.2g} px rms apart ({found.verdict}) Give one of them only."
        )


def _oriented(lf: LightField, layout: Layout) -> LightField:
    """The light field with its view axes as the words of layout say."""
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


def _sentence(lf: LightField, path: Path, lattice: Lattice, whence: str, layout: Layout) -> str:
    V, U, ny, nx = lf.shape[:4]
    colours = " of 3 colours" if len(lf.shape) == 5 else ""
    flat = "divided by the white image" if layout.white and layout.devignette is not False else ""
    parts = [
        f"{V} x {U} views (V x U) of {ny} x {nx} pixels{colours} from {path}",
        flat,
        f"lattice {whence} ({lattice.verdict.rstrip('.')})",
        *layout.said(),
    ]
    return ", ".join(part for part in parts if part)
