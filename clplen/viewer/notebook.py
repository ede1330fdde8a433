"""Viewer in a notebook: a widget, or a page in a frame."""

from __future__ import annotations

import html
from importlib.util import find_spec
from typing import Any

from numpy.typing import ArrayLike

from clplen.compute.device import Device
from clplen.io.page.html_page import content_of, page_of, script, style
from clplen.io.page.light_field_item import PageOptions
from clplen.io.page.samples import Content
from clplen.lightfield.depth.depth_maps import DepthMap
from clplen.lightfield.model.light_field import LightField
from clplen.viewer.computations import sentence_of
from clplen.viewer.device_computing import DeviceComputing

MIN_HEIGHT = 200  # pixels; lower viewers have no room for the controls


def view(
    subject: Any,
    *,
    title: str | None = None,
    depth: DepthMap | ArrayLike | None = None,
    compare: bool = False,
    height: int = 600,
    quality: int | None = None,
    downscale: int = 1,
    views: tuple[int, int] | None = None,
) -> Any:
    """Show light fields, focal stacks, volumes, depth maps and pictures in a notebook.

    With anywidget (``pip install "clplen[notebook]"``) the viewer is a widget that computes depth
    and exact pictures on the device of the light field. Without anywidget it is the page of
    `clplen.io.write_html` in a frame.

    Parameters
    ----------
    subject : LightField, FocalStack, DepthMap, RawImage, Image, array_like, or a list or dict
        Data to show, as in `clplen.io.write_html`.
    title : str, optional
        Title of the page, as in `clplen.io.write_html`.
    depth : DepthMap or array_like, optional
        Depth of the centre view of a light field.
    compare : bool
        True to show several subjects side by side.
    height : int
        Height of the widget in pixels, at least 200.
    quality : int, optional
        JPEG quality of the views of light fields, 1 to 100, as in `clplen.io.write_html`.
    downscale : int
        Downscaling factor: blocks of ``downscale`` x ``downscale`` pixels are averaged.
    views : tuple of int, optional
        Maximum number of views (V, U); the central views are kept.

    Returns
    -------
    object
        Viewer, shown by a notebook as the last line of a cell.

    Raises
    ------
    ValueError, ShapeError, TypeError
        If an argument is invalid, as in `clplen.io.write_html`.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.full((3, 3, 32, 48), 128, np.uint8))
    >>> viewer = clplen.view(lf, title="Grey", height=400)  # shown as the last line of a cell
    >>> hasattr(viewer, "_repr_mimebundle_") or hasattr(viewer, "_repr_html_")
    True
    """
    if height < MIN_HEIGHT:
        raise ValueError(f"height must be at least {MIN_HEIGHT} pixels, got {height!r}.")
    options = PageOptions(quality, downscale, views)
    content = content_of(subject, title=title, depth=depth, options=options, compare=compare)
    if find_spec("anywidget") is None:
        return PageFrame(page_of(content, content.encoded()).decode(), height)
    return _widget(content, _light_fields(subject), height)


class PageFrame:
    """Page in a frame of a notebook.

    Attributes
    ----------
    page : str
        HTML source.
    height : int
        Height in pixels.
    """

    def __init__(self, page: str, height: int) -> None:
        self.page, self.height = page, height

    def __repr__(self) -> str:
        return f"<PageFrame {len(self.page) / 1e6:.1f} MB>"

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{html.escape(self.page)}" sandbox="allow-scripts allow-downloads" '
            f'style="width: 100%; height: {self.height}px; border: 0" title="viewer"></iframe>'
        )


def _light_fields(subject: Any) -> dict[int, LightField]:
    """Return the light fields among the subjects, by their numbers."""
    if isinstance(subject, dict):
        subjects = list(subject.values())
    else:
        subjects = subject if isinstance(subject, list) else [subject]
    return {n: entry for n, entry in enumerate(subjects) if isinstance(entry, LightField)}


def _widget(content: Content, light_fields: dict[int, LightField], height: int) -> Any:
    """Return the page as a widget that computes in the notebook's kernel."""
    import anywidget
    import traitlets

    class ViewerWidget(anywidget.AnyWidget):
        """Viewer with the content of `view`."""

        _esm = script("widget") + "export default { render: widget_js.render };\n"
        _css = style()
        content: Any = traitlets.Dict().tag(sync=True)
        blobs: Any = traitlets.List().tag(sync=True)
        computes: Any = traitlets.Bool().tag(sync=True)
        height: Any = traitlets.Int().tag(sync=True)

    widget = ViewerWidget(
        content=content.about,
        blobs=content.encoded(),
        computes=bool(light_fields),
        height=height,
    )
    if light_fields:
        device: Device = next(iter(light_fields.values())).device
        computing = DeviceComputing(device, dict(light_fields))
        widget.on_msg(lambda _, message, __: _answer(widget, computing, message))
    return widget


def _answer(widget: Any, computing: DeviceComputing, message: Any) -> None:
    """Compute the answer to a request of the widget, and send it."""
    if not isinstance(message, dict) or not isinstance(message.get("request"), dict):
        return
    address = {"id": message.get("id"), "channel": message.get("channel")}

    def progress(fraction: float, what: str) -> None:
        widget.send({**address, "progress": fraction, "what": what})

    try:
        result, blobs = computing(message["request"], progress)
    except Exception as error:
        widget.send({**address, "error": sentence_of(error)})
    else:
        widget.send({**address, "result": result}, buffers=blobs)
