"""A page for a browser: one HTML file with scripts, styles and data, which asks no network."""

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

# In the order in which one needs the other.
_SCRIPTS = (
    "law", "lookup_tables", "tone", "source", "renderer", "controls", "stage", "display",
    "commands", "search", "device", "light_field", "track_marks", "volume", "compare", "viewer",
)  # fmt: skip
_SUFFIXES = (".html", ".htm")
_IMPORT = re.compile(r"^import (\{[^}]*\}) from \"\./(\w+)\.js\";", re.M)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const) (\w+))", re.M)
_PLACE = re.compile(r"\{(connect|version|title|style|script|content|data)\}")


@runtime_checkable
class HasVolume(Protocol):
    """A volume (..., z, y, x) with the z of its planes and (dy, dx) of its voxels in metres."""

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

    The file holds everything and asks no network: it opens from a disk, goes by mail, or lies on
    any server. In the page the viewpoint is dragged, a click focuses, the wheel zooms.

    Parameters
    ----------
    path : path-like
        ``.html``.
    subject : LightField, FocalStack, DepthMap, RawImage, Image, array_like, or a list or dict
        What is shown. Arrays are pictures (y, x) or (y, x, 3), volumes (z, y, x), or light fields
        (v, u, y, x) and (v, u, y, x, c); what has a ``volume`` (of `clplen.deconvolve`) is taken
        as such. Of a list or dict {name: subject} each has a tab.
    title : str, optional
        Of the page.
    depth : DepthMap or array_like, optional
        Of the centre view of a light field: then a click focuses by it, viewpoints between views
        follow it, and everything can be in focus.
    quality : int, optional
        Of JPEG, 1 to 100, for the views of light fields; by default nothing is lost of 8-bit
        samples, and others have 16 bits over their range.
    downscale : int
        Pixels along y and x of which the page keeps the mean.
    views : tuple of int, optional
        At most so many views (V, U), those in the middle.
    compare : bool
        Whether several are shown side by side, with one zoom and one cursor.
    durable : bool
        Whether to wait until the disk has it, as in `clplen.files.replacing`.

    Raises
    ------
    ValueError, ShapeError, TypeError, OSError
        If the suffix is another one, or an option is out of range; if the subject is none of these;
        if it cannot be written.

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
        raise ValueError(f"A page is written as .html, not as {path}.")
    options = PageOptions(quality, downscale, views)
    content = content_of(subject, title=title, depth=depth, options=options, compare=compare)
    write_page(path, content, durable=durable)


def write_page(path: PathLike, content: Content, *, durable: bool = False) -> int:
    """Write a page with all its data; its size in bytes."""
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
    """What a page of some subjects shows; parameters as of `write_html`."""
    options = options or PageOptions()
    content = Content()
    depth = None if depth is None else as_depth_map(depth)
    named = subject if isinstance(subject, dict) else _named(subject)
    if not named:
        raise ValueError("There is nothing to show: give at least one light field or picture.")
    if compare and len(named) < 2:
        raise ValueError("At least two results are compared, and one was given.")
    items = [
        item_of(thing, content, name=str(name), depth=depth, options=options)
        for name, thing in named.items()
    ]
    content.about = {"title": title or ", ".join(map(str, named)), "items": items}
    if compare:
        content.about["compare"] = True
    return content


def _named(subject: Any) -> dict[str, Any]:
    things = subject if isinstance(subject, list) else [subject]
    kinds = [type(thing).__name__ for thing in things]
    named = {}
    for i, (kind, thing) in enumerate(zip(kinds, things, strict=True)):
        number = f" {kinds[: i + 1].count(kind)}" if kinds.count(kind) > 1 else ""
        named[_WORDS.get(kind, kind) + number] = thing
    return named


_WORDS = {
    "LightField": "light field",
    "FocalStack": "focal stack",
    "DepthMap": "depth map",
    "RawImage": "raw image",
    "Image": "picture",
    "ndarray": "array",
    "DeconvolutionResult": "volume",
}


def item_of(
    thing: Any, content: Content, *, name: str, depth: DepthMap | None, options: PageOptions
) -> dict[str, Any]:
    """Add one subject to a page; what describes it."""
    small: dict[str, Any] = {"name": name, "downscale": options.downscale}
    if isinstance(thing, LightField):
        return light_field_item(thing, content, name=name, options=options, depth=depth)
    if isinstance(thing, FocalStack):
        return stack_item(thing, content, **small)
    if isinstance(thing, DepthMap):
        words: dict[str, Any] = {"unit": "px per view", "table": "viridis"}
        return volume_item(thing.disparity[None, None], content, **small, **words)
    if isinstance(thing, RawImage | Image):
        return volume_item(thing.to_numpy()[None, None], content, **small)
    if isinstance(thing, HasVolume):
        volume = np.asarray(thing.volume)
        planes = None if thing.planes is None else ("z", "m", thing.planes)
        voxel = None if thing.voxel is None else (step_of(thing.planes), *thing.voxel)
        words = {"planes": planes, "voxel": voxel, "table": "magma"}
        return volume_item(volume.reshape(-1, *volume.shape[-3:]), content, **small, **words)
    values = host_array(thing, "What a page shows")
    if values.dtype.kind not in "uifb":
        raise TypeError(
            f"A page shows light fields, stacks, depth maps, volumes and pictures, not "
            f"{type(thing).__name__}."
        )
    if values.ndim >= 4:
        lf = LightField.from_array(values)
        return light_field_item(lf, content, name=name, options=options, depth=depth)
    if values.ndim not in (2, 3):
        raise ShapeError(f"A page shows arrays of two to five axes, not of shape {values.shape}.")
    picture = values.ndim == 2 or values.shape[2] == 3
    return volume_item(
        values[None, None] if picture else values[None], content, **small, dtype=values.dtype
    )


def stack_item(stack: FocalStack, content: Content, **words: Any) -> dict[str, Any]:
    """Add a focal stack to a page; what describes it."""
    alphas = np.isfinite(stack.alphas).all()
    planes = ("alpha", "", stack.alphas) if alphas else ("disparity", "", stack.disparities)
    voxel = None
    if stack.spacing is not None:
        voxel = (None, abs(stack.spacing[2]), abs(stack.spacing[3]))
    return volume_item(stack.to_numpy()[None], content, planes=planes, voxel=voxel, **words)


def step_of(planes: Any) -> float | None:
    """The distance of planes that are equidistant."""
    steps = np.diff(np.asarray([] if planes is None else planes, np.float64))
    if steps.size == 0 or np.ptp(steps) > 1e-6 * abs(steps[0]):
        return None
    return abs(float(steps[0]))


def page_of(content: Content, blobs: list[bytes] | None) -> bytes:
    """The HTML of a page with its data, or, with None, of one that asks its server for them."""
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
    return _PLACE.sub(lambda found: parts[found[1]], page).encode()


def style() -> str:
    """The viewer's style sheet."""
    return (files("clplen") / "viewer" / "page" / "viewer.css").read_text(encoding="utf-8")


def script(*more: str) -> str:
    """The viewer's modules in one script, each a function that returns what it exports.

    ``more`` are modules beyond those of a page.
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
    """JSON that ends no script element and holds no NaN."""
    return json.dumps(about, allow_nan=False).replace("<", "\\u003c")
