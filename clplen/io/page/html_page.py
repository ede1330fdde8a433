"""Pages for a browser: one HTML file with scripts, styles and data, without network access."""

from __future__ import annotations

import base64
import html
import json
import re
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array
from clplen.compute.arrays import Image
from clplen.errors import ShapeError
from clplen.files import PathLike, replacing
from clplen.io.page.light_field_item import PageOptions, light_field_item
from clplen.io.page.samples import Content
from clplen.io.page.volume_item import volume_item
from clplen.lightfield.depth.depth_maps import DepthMap, as_depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.outputs import MARK
from clplen.reprs import printable

# Modules in the order of their imports.
_SCRIPTS = (
    "law", "lookup_tables", "tone", "source", "renderer", "controls", "stage", "display",
    "commands", "search", "device", "light_field", "track_marks", "volume", "compare", "viewer",
)  # fmt: skip
_SUFFIXES = (".html", ".htm")
_IMPORT = re.compile(r"^import (\{[^}]*\}) from \"\./(\w+)\.js\";", re.M)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const) (\w+))", re.M)
_PLACEHOLDER = re.compile(r"\{(connect|version|title|style|script|content|data)\}")


@runtime_checkable
class HasVolume(Protocol):
    """Volume (..., z, y, x) with z of its planes and voxel size (dy, dx) in metres."""

    @property
    def volume(self) -> Any: ...
    @property
    def planes(self) -> Any: ...
    @property
    def voxel(self) -> Any: ...


def write_html(
    path: PathLike,
    subject: Any,
    *,
    title: str | None = None,
    depth: DepthMap | ArrayLike | None = None,
    quality: int | None = None,
    downscale: int = 1,
    views: tuple[int, int] | None = None,
    compare: bool = False,
    durable: bool = False,
) -> None:
    """Write a page that shows light fields, stacks, volumes, maps and pictures in any browser.

    The file contains all data and needs no network: open it from a disk, send it by mail or put it
    on a server. In the page, drag to move the viewpoint, click to focus and turn the wheel to zoom.

    Parameters
    ----------
    path : path-like
        ``.html`` file.
    subject : LightField, FocalStack, DepthMap, RawImage, Image, array_like, or a list or dict
        Data to show. Arrays are pictures (y, x) or (y, x, 3), volumes (z, y, x), or light fields
        (v, u, y, x) and (v, u, y, x, c); objects with a ``volume`` (of `clplen.deconvolve`) are
        volumes. Each item of a list or dict {name: subject} has a tab.
    title : str, optional
        Title of the page.
    depth : DepthMap or array_like, optional
        Depth of the centre view of a light field. It allows a click to focus, viewpoints between
        views, and everything in focus.
    quality : int, optional
        JPEG quality of the views of light fields, 1 to 100. By default 8-bit samples are lossless,
        and other samples have 16 bits over their range.
    downscale : int
        Number of pixels along y and x that are averaged.
    views : tuple of int, optional
        Largest number of views (V, U); the central ones are used.
    compare : bool
        True to show several subjects side by side, with a common zoom and cursor.
    durable : bool
        True to wait until the file is on disk, as in `clplen.files.replacing`.

    Raises
    ------
    ValueError, ShapeError, TypeError, OSError
        If the suffix is unknown, or an option is out of range; if the subject is not supported; if
        the file cannot be written.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((3, 3), (32, 32))
    >>> clplen.io.write_html("scene.html", {"scene": lf, "mean": lf.to_numpy().mean((0, 1))})
    >>> with open("scene.html", encoding="utf-8") as page:
    ...     page.readline().strip()
    '<!doctype html>'
    """
    if Path(path).suffix.lower() not in _SUFFIXES:
        raise ValueError(f"path must end in .html for a page, got {path}.")
    options = PageOptions(quality, downscale, views)
    content = content_of(subject, title=title, depth=depth, options=options, compare=compare)
    write_page(path, content, durable=durable)


def write_page(path: PathLike, content: Content, *, durable: bool = False) -> int:
    """Write a page with all its data, and return its size in bytes."""
    page = page_of(content, content.encoded())
    with replacing(path, durable) as temporary:
        temporary.write_bytes(page)
    return len(page)


def content_of(
    subject: Any,
    *,
    title: str | None = None,
    depth: DepthMap | ArrayLike | None = None,
    options: PageOptions | None = None,
    compare: bool = False,
) -> Content:
    """Return the content of a page of some subjects; parameters as for `write_html`."""
    options = options or PageOptions()
    content = Content()
    depth = None if depth is None else as_depth_map(depth)
    subjects = subject if isinstance(subject, dict) else _by_name(subject)
    if not subjects:
        raise ValueError("subject must contain at least one light field or picture.")
    if compare and len(subjects) < 2:
        raise ValueError("compare=True needs at least two subjects.")
    items = [
        item_of(item, content, name=str(name), depth=depth, options=options)
        for name, item in subjects.items()
    ]
    content.about = {"title": title or ", ".join(map(str, subjects)), "items": items}
    if compare:
        content.about["compare"] = True
    return content


def _by_name(subject: Any) -> dict[str, Any]:
    subjects = subject if isinstance(subject, list) else [subject]
    kinds = [type(item).__name__ for item in subjects]
    by_name = {}
    for i, (kind, item) in enumerate(zip(kinds, subjects, strict=True)):
        number = f" {kinds[: i + 1].count(kind)}" if kinds.count(kind) > 1 else ""
        by_name[_KIND_NAMES.get(kind, kind) + number] = item
    return by_name


_KIND_NAMES = {
    "LightField": "light field",
    "FocalStack": "focal stack",
    "DepthMap": "depth map",
    "RawImage": "raw image",
    "Image": "picture",
    "ndarray": "array",
    "DeconvolutionResult": "volume",
}


def item_of(
    subject: Any, content: Content, *, name: str, depth: DepthMap | None, options: PageOptions
) -> dict[str, Any]:
    """Add a subject to a page, and return its description."""
    small: dict[str, Any] = {"name": name, "downscale": options.downscale}
    if isinstance(subject, LightField):
        return light_field_item(subject, content, name=name, options=options, depth=depth)
    if isinstance(subject, FocalStack):
        return stack_item(subject, content, **small)
    if isinstance(subject, DepthMap):
        style: dict[str, Any] = {"unit": "px per view", "table": "viridis"}
        return volume_item(subject.disparity[None, None], content, **small, **style)
    if isinstance(subject, RawImage | Image):
        return volume_item(subject.to_numpy()[None, None], content, **small)
    if isinstance(subject, HasVolume):
        volume = np.asarray(subject.volume)
        planes = None if subject.planes is None else ("z", "m", subject.planes)
        voxel = None if subject.voxel is None else (step_of(subject.planes), *subject.voxel)
        style = {"planes": planes, "voxel": voxel, "table": "magma"}
        return volume_item(volume.reshape(-1, *volume.shape[-3:]), content, **small, **style)
    values = host_array(subject, "What a page shows")
    if values.dtype.kind not in "uifb":
        raise TypeError(
            f"subject must be a light field, stack, depth map, volume or picture, got "
            f"{type(subject).__name__}."
        )
    if values.ndim >= 4:
        lf = LightField.from_array(values)
        return light_field_item(lf, content, name=name, options=options, depth=depth)
    if values.ndim not in (2, 3):
        raise ShapeError(f"Arrays must have two to five axes, got shape {values.shape}.")
    picture = values.ndim == 2 or values.shape[2] == 3
    return volume_item(
        values[None, None] if picture else values[None], content, **small, dtype=values.dtype
    )


def stack_item(stack: FocalStack, content: Content, **settings: Any) -> dict[str, Any]:
    """Add a focal stack to a page, and return its description."""
    alphas = np.isfinite(stack.alphas).all()
    planes = ("alpha", "", stack.alphas) if alphas else ("disparity", "", stack.disparities)
    voxel = None
    if stack.spacing is not None:
        voxel = (None, abs(stack.spacing[2]), abs(stack.spacing[3]))
    return volume_item(stack.to_numpy()[None], content, planes=planes, voxel=voxel, **settings)


def step_of(planes: Any) -> float | None:
    """Return the distance of equidistant planes, or None."""
    steps = np.diff(np.asarray([] if planes is None else planes, np.float64))
    if steps.size == 0 or np.ptp(steps) > 1e-6 * abs(steps[0]):
        return None
    return abs(float(steps[0]))


def page_of(content: Content, blobs: list[bytes] | None) -> bytes:
    """Return the HTML of a page with its data; without data, they are requested from a server."""
    about = dict(content.about)
    data = ""
    if blobs is None:
        about["server"] = True
    else:
        about["sizes"] = [len(blob) for blob in blobs]
        data = "\n".join(
            f'<script type="text/plain" id="clplen-data-{n}">{base64.b64encode(blob).decode()}'
            "</script>"
            for n, blob in enumerate(blobs)
        )
    folder = files("clplen") / "viewer" / "page"
    parts = {
        "connect": "'self'" if blobs is None else "'none'",
        "version": f"{version('clplen')}. {MARK}",
        "title": html.escape(printable(str(about["title"]))),
        "style": style(),
        "script": script(),
        "content": _json(about),
        "data": data,
    }
    page = (folder / "page.html").read_text(encoding="utf-8")
    return _PLACEHOLDER.sub(lambda match: parts[match[1]], page).encode()


def style() -> str:
    """Return the style sheet of the viewer."""
    return (files("clplen") / "viewer" / "page" / "viewer.css").read_text(encoding="utf-8")


def script(*more: str) -> str:
    """Return the viewer's modules as one script; each becomes a function that returns its exports.

    ``more`` are additional modules.
    """
    folder = files("clplen") / "viewer" / "page"
    parts = []
    for name in (*_SCRIPTS, *more):
        text = (folder / f"{name}.js").read_text(encoding="utf-8")
        exports = ", ".join(_EXPORT.findall(text))
        inner = _EXPORT.sub("", _IMPORT.sub(r"const \1 = \2_js;", text))
        parts.append(f"const {name}_js = (() => {{\n{inner}\nreturn {{ {exports} }};\n}})();\n")
    return "".join(parts) + "const { mount, start } = viewer_js;\n"


def _json(about: dict[str, Any]) -> str:
    """Return JSON that cannot end a script element and has no NaN."""
    return json.dumps(about, allow_nan=False).replace("<", "\\u003c")
