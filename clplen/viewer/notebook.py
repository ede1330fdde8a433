"""Light fields, stacks, volumes and maps in a notebook: a widget, or a page in a frame."""

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

_LEAST_HEIGHT = 200  # pixels


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

    With anywidget (``pip install "clplen[notebook]"``) it is a widget, which asks the device of the
    light field for depth and exact pictures; without it the page of `clplen.io.write_html` in a
    frame.

    Parameters
    ----------
    subject : LightField, FocalStack, DepthMap, RawImage, Image, array_like, or a list or dict
        What is shown, as in `clplen.io.write_html`.
    title : str, optional
        Of the page, as in `clplen.io.write_html`.
    depth : DepthMap or array_like, optional
        Of the centre view of a light field.
    compare : bool
        Whether several are shown side by side.
    height : int
        Of the widget in pixels, at least 200.
    quality : int, optional
        Of JPEG, 1 to 100, for the views of light fields, as in `clplen.io.write_html`.
    downscale : int
        Pixels along y and x of which the page keeps the mean.
    views : tuple of int, optional
        At most so many views (V, U), those in the middle.

    Returns
    -------
    object
        What a notebook shows as the viewer.

    Raises
    ------
    ValueError, ShapeError, TypeError
        As `clplen.io.write_html`.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.full((3, 3, 32, 48), 128, np.uint8))
    >>> viewer = clplen.view(lf, title="Grey", height=400)  # shown as the last line of a cell
    >>> hasattr(viewer, "_repr_mimebundle_") or hasattr(viewer, "_repr_html_")
    True
    """
    if height < _LEAST_HEIGHT:
        raise ValueError(f"height is at least {_LEAST_HEIGHT} pixels, not {height!r}.")
    options = PageOptions(quality, downscale, views)
    content = content_of(subject, title=title, depth=depth, options=options, compare=compare)
    if find_spec("anywidget") is None:
        return PageFrame(page_of(content, content.encoded()).decode(), height)
    return _widget(content, _light_fields(subject), height)


class PageFrame:
    """A page in a frame, as a notebook shows it.

    Attributes
    ----------
    page : str
        HTML.
    height : int
        In pixels.
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
    """The light fields on a device among what is shown, by number."""
    if isinstance(subject, dict):
        things = list(subject.values())
    else:
        things = subject if isinstance(subject, list) else [subject]
    return {n: thing for n, thing in enumerate(things) if isinstance(thing, LightField)}


def _widget(content: Content, light_fields: dict[int, LightField], height: int) -> Any:
    """The page as a widget that computes in the notebook's kernel."""
    import anywidget
    import traitlets

    class ViewerWidget(anywidget.AnyWidget):
        """The viewer around what `view` was given."""

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
    """Compute what the widget asks, and send it."""
    if not isinstance(message, dict) or not isinstance(message.get("request"), dict):
        return
    of = {"id": message.get("id"), "channel": message.get("channel")}

    def progress(share: float, what: str) -> None:
        widget.send({**of, "progress": share, "what": what})

    try:
        result, blobs = computing(message["request"], progress)
    except Exception as error:
        widget.send({**of, "error": sentence_of(error)})
    else:
        widget.send({**of, "result": result}, buffers=blobs)
