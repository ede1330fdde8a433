"""Draw pictures of the site: python docs/images/make_cards.py

start.webp shows the result of the code block of docs/index.md. The cards of the tutorials and
how-to pages come from that light field, from docs/images and from the pictures of the gallery.
plots/ shows the calls of plots.toml.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image, ImageDraw, ImageOps

import clplen

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

IMAGES = Path(__file__).parent
GALLERY = IMAGES.parent / "gallery" / "pictures"
SIZE = (360, 240)  # pixels of a card
# Parts of pictures: left, top, right and bottom as fractions
CROPS = {
    "viewer": (IMAGES / "viewer.jpg", (0.0, 0.0, 1.0, 1.0)),
    "tracks": (IMAGES / "microscope_tracks.png", (0.02, 0.06, 0.33, 0.44)),
    "vesicle": (IMAGES / "microscope.png", (0.01, 0.05, 0.33, 0.9)),
    "slider": (IMAGES / "phone_or_slider.webp", (0.022, 0.548, 0.442, 0.976)),
    "lytro": (GALLERY / "fig_4_7_real_cameras.webp", (0.005, 0.16, 0.185, 0.84)),
}


def uint8(values: Any) -> np.ndarray:
    """Return values from 0 to 1 as 8-bit samples."""
    return np.uint8(np.clip(np.asarray(values), 0, 1) * 255 + 0.5)


def colours(values: Any, name: str = "viridis") -> np.ndarray:
    """Return values as 8-bit colours of a colour map, from the smallest to the largest."""
    values = np.asarray(values, float)
    return uint8(plt.get_cmap(name)((values - values.min()) / np.ptp(values))[..., :3])


def write(name: str, picture: Any, size: tuple[int, int] = SIZE) -> None:
    """Write a picture, cropped to the shape of a card, as WebP."""
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    image = ImageOps.fit(image.convert("RGB"), size, Image.Resampling.LANCZOS)
    image.save(IMAGES / "cards" / f"{name}.webp", quality=45, method=6)


def start_block() -> dict[str, Any]:
    """Run the Python block of the start page; return its names."""
    text = (IMAGES.parent / "index.md").read_text(encoding="utf-8")
    match = re.search(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert match is not None
    names: dict[str, Any] = {}
    exec(match[1], names)
    return names


def start_picture(near: Any, far: Any, disparity: Any) -> Image.Image:
    """Return the three results of the start page side by side."""
    panels = [uint8(near), uint8(far), colours(disparity)]
    gap = np.full((panels[0].shape[0], 12, 3), 255, np.uint8)
    return Image.fromarray(np.hstack([panels[0], gap, panels[1], gap, panels[2]]))


def anaglyph(left: Any, right: Any) -> np.ndarray:
    """Return the red of the left view with the green and blue of the right view."""
    return np.dstack([uint8(left)[..., :1], uint8(right)[..., 1:]])


def mosaic(views: Any, rows: int, columns: int) -> np.ndarray:
    """Return views (v, u, y, x, c) side by side, every second pixel."""
    v, u = (np.linspace(0, n - 1, m).round().astype(int)
            for n, m in zip(views.shape[:2], (rows, columns), strict=True))  # fmt: skip
    return uint8(np.vstack([np.hstack([views[j, i, ::2, ::2] for i in u]) for j in v]))


def points(picture: Any, disparity: Any) -> Image.Image:
    """Return a point cloud of a picture and its disparity, drawn obliquely."""
    figure = plt.figure(figsize=(3.6, 2.4), dpi=100, facecolor="k")
    axes = figure.add_axes((-0.25, -0.45, 1.5, 1.9), projection="3d", facecolor="k")
    y, x = np.mgrid[: disparity.shape[0] : 2, : disparity.shape[1] : 2]
    shades = np.clip(picture[::2, ::2], 0, 1).reshape(-1, 3)
    axes.scatter(x, -45 * disparity[::2, ::2], -y, c=shades, s=1.5, linewidth=0)
    axes.view_init(18, -60)
    axes.set_axis_off()
    axes.set_aspect("equal")
    figure.canvas.draw()
    image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3])
    plt.close(figure)
    return image


def tiles(picture: Any) -> np.ndarray:
    """Return a picture of which only one tile is in memory."""
    dim = np.asarray(picture) // 3
    dim[::80], dim[:, ::80] = 255, 255
    dim[80:160, 160:240] = picture[80:160, 160:240]
    return dim


def chips(rows: int, columns: int) -> Image.Image:
    """Return processors in rows and columns."""
    page = Image.new("RGB", (720, 480), (232, 240, 242))
    draw = ImageDraw.Draw(page)
    side = 480 / rows * 0.55
    for row, column in np.ndindex(rows, columns):
        x, y = 720 * (column + 0.5) / columns, 480 * (row + 0.5) / rows
        for step in np.linspace(-0.38, 0.38, 6) * side:
            pins = ((x + step, y - 0.62 * side, x + step, y + 0.62 * side),
                    (x - 0.62 * side, y + step, x + 0.62 * side, y + step))  # fmt: skip
            for pin in pins:
                draw.line(pin, fill=(90, 105, 115), width=round(side / 18))
        for scale, shade in ((0.5, (38, 50, 56)), (0.3, (10, 125, 145))):
            draw.rounded_rectangle((x - scale * side, y - scale * side,
                                    x + scale * side, y + scale * side),
                                   side / 14, fill=shade)  # fmt: skip
    return page


def sample_views() -> np.ndarray:
    """Return the centre views of three sample scenes above their disparities."""
    columns = []
    for sample in clplen.cameras.sample_scenes(5, (80, 80)):
        if sample.name in ("layers", "spheres", "clutter"):
            lf, truth = sample.scene.light_field((3, 3), (80, 80))
            columns.append(np.vstack([uint8(lf.view(1, 1)), colours(truth.disparity)]))
    return np.hstack(columns)


def checkerboard() -> Image.Image:
    """Return an oblique checkerboard as a camera sees it."""
    board = Image.new("L", (900, 600), 255)
    draw = ImageDraw.Draw(board)
    for row, column in np.ndindex(6, 9):
        if (row + column) % 2 == 0:
            corner = 90 + 80 * column, 60 + 80 * row
            draw.rectangle((*corner, corner[0] + 79, corner[1] + 79), fill=25)
    shape = (1.1, -0.25, 20, 0.12, 1.25, -110, 2e-4, -3e-4)
    return board.transform((720, 480), Image.Transform.PERSPECTIVE, shape, fillcolor=150)


def draw_plots(names: dict[str, Any]) -> None:
    """Draw the calls of plots.toml, with the names of the start page."""
    settings = tomllib.loads((IMAGES / "plots.toml").read_text(encoding="utf-8"))
    exec(settings["setup"], names)
    for name, call in settings["calls"].items():
        figure = eval(call, names)
        image = Image.fromarray(clplen.plot.rendered(figure, dpi=100))
        image.thumbnail((700, 500), Image.Resampling.LANCZOS)
        image.save(IMAGES / "plots" / f"{name}.webp", quality=45, method=6)


def main() -> None:
    """Draw all pictures."""
    for folder in ("cards", "plots"):
        (IMAGES / folder).mkdir(exist_ok=True)
    names = start_block()
    draw_plots(dict(names))
    lf, depth = names["lf"], names["depth"]
    near, far, views = (names[key].to_numpy() for key in ("near", "far", "lf"))
    disparity = np.asarray(depth.disparity)
    start = start_picture(near, far, disparity)
    start.save(IMAGES / "start.webp", quality=75, method=6)
    centre = views[views.shape[0] // 2]
    write("refocus", np.hstack([uint8(near)[:, : near.shape[1] // 2],
                                uint8(far)[:, near.shape[1] // 2 :]]))  # fmt: skip
    write("depth", colours(disparity))
    write("views", mosaic(views, 3, 3))
    exchanged = clplen.LightField.from_array(np.ascontiguousarray(views[:, ::-1]))
    write("wrong_order", uint8(clplen.refocus(exchanged, disparity=1.8).to_numpy()))
    write("tiles", tiles(uint8(centre[len(centre) // 2])))
    write("chip", chips(1, 1))
    write("two_chips", chips(1, 2))
    write("chips", chips(2, 3))
    write("samples", sample_views())
    write("quilt", mosaic(views, 4, 4))
    write("anaglyph", anaglyph(centre[0], centre[-1]))
    write("points", points(uint8(clplen.all_in_focus(lf).to_numpy()) / 255, disparity))
    write("stack", stack_picture([uint8(far), uint8(centre[len(centre) // 2]), uint8(near)]))
    write("checkerboard", checkerboard())
    for name, (file, box) in CROPS.items():
        with Image.open(file) as image:
            width, height = image.size
            part = [round(a * b) for a, b in zip(box, (width, height) * 2, strict=True)]
            write(name, image.convert("RGB").crop(part))


def stack_picture(pictures: list[np.ndarray]) -> Image.Image:
    """Return pictures laid on one another as the planes of a focal stack."""
    page = Image.new("RGB", (720, 480), "white")
    for step, picture in enumerate(pictures):
        plane = ImageOps.expand(ImageOps.fit(Image.fromarray(picture), (480, 320)), 4, "white")
        page.paste(plane, (20 + 100 * step, 20 + 60 * step))
    return page


if __name__ == "__main__":
    main()
