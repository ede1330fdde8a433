"""What the viewer draws in a browser against what clplen computes, in levels of 255.

Light fields of odd, even and unlike counts of views, of one and three channels, of 8 bits, 16 bits
and floats, with views of weight 0 and views on no grid are written as pages. Each is shown with
several viewpoints, apertures and planes, and read back from the canvas and from the saved picture.
Needs Chromium (/usr/bin/chromium, or $CLPLEN_CHROMIUM) and `pip install playwright`.
"""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as Pillow

import clplen

CHROMIUM = os.environ.get("CLPLEN_CHROMIUM", "/usr/bin/chromium")
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]
READY = "window.clplen && window.clplen.ready.then(() => true)"
_CANVAS = """
async (state) => {
  const view = window.clplen.view;
  const node = view.stage.element;
  const [ny, nx] = view.stage.size;
  Object.assign(node.style, {flex: "none", width: nx + "px", height: ny + "px"});
  await new Promise((done) => setTimeout(done, 30));
  view.stage.resize();
  view.change(state);
  view.settle();
  return [view.stage.canvas.toDataURL(), view.picture().toDataURL()];
}
"""
# Light fields: shape, dtype, what is special.
LIGHT_FIELDS: dict[str, tuple[tuple[int, ...], str, str]] = {
    "odd, grey": ((5, 7, 37, 53), "uint8", ""),
    "even, colour": ((4, 6, 41, 29, 3), "uint8", ""),
    "floats": ((3, 5, 31, 47), "float32", ""),
    "16 bits, colour": ((5, 3, 29, 31, 3), "uint16", ""),
    "weights 0": ((6, 6, 33, 35), "uint8", "weights"),
    "no grid": ((3, 4, 35, 39, 3), "uint8", "positions"),
    "one row": ((1, 9, 23, 61), "uint8", ""),
    "oblong steps": ((5, 5, 27, 43), "uint8", "spacing"),
    "2209 views": ((47, 47, 11, 13), "uint8", ""),  # more than the layers of a texture
    "half floats": ((3, 3, 33, 21), "float16", "dark"),
}
_SHARES = {"black": 0.0, "white": 1.0}
# States of the viewer, v and u as shares of the views, black and white of white.
STATES: dict[str, dict[str, Any]] = {
    "all, whole d": {"shape": "all", "d": 2.0},
    "all, part of d": {"shape": "all", "d": -0.73},
    "all, far d": {"shape": "all", "d": 6.37},
    "disc": {"shape": "disc", "diameter": 0.61, "d": 0.4},
    "disc, aside": {"shape": "disc", "diameter": 0.37, "v": 0.21, "u": 0.83, "d": -1.31},
    "square": {"shape": "square", "across": 3, "d": 1.25},
    "square, aside": {"shape": "square", "across": 2, "v": 0.77, "u": 0.36, "d": -0.2},
    "one view": {"shape": "one", "v": 1.0, "u": 0.0, "d": 0.8},
    "between views": {"shape": "one", "v": 0.33, "u": 0.71, "d": 0.9},
    "all in focus": {"shape": "all", "sharp": True},
    "disc in focus": {"shape": "disc", "diameter": 0.61, "sharp": True},
    "by the map": {"shape": "one", "v": 0.33, "u": 0.71, "sharp": True},
    "sRGB": {"shape": "all", "d": 0.31, "curve": "srgb"},
    "logarithmic": {"shape": "disc", "diameter": 0.45, "d": 0.31, "curve": "log"},
    "gamma, limits": {"shape": "all", "d": -0.4, "curve": "gamma", "gamma": 1.7, "black": 0.1,
                      "white": 0.8},
}


def light_field(name: str) -> clplen.LightField:
    """One of `LIGHT_FIELDS`, of smooth noise and sharp steps."""
    shape, dtype, special = LIGHT_FIELDS[name]
    rng = np.random.default_rng(sorted(LIGHT_FIELDS).index(name))
    a = rng.random(shape)
    a[..., : shape[2] // 2, :] *= 0.5 if len(shape) == 4 else 1.0
    a[:, :, shape[2] // 3, shape[3] // 4] = 1.0
    scale = {"uint8": 255, "uint16": 4095, "float32": 0.37, "float16": 3.0}[dtype]
    values = a * scale
    data = np.rint(values).astype(dtype) if dtype.startswith("u") else values.astype(dtype)
    words: dict[str, Any] = {}
    if special == "dark":
        data = (data - 1).astype(dtype)  # some samples are negative
    if special == "weights":
        weights = rng.random(shape[:2]).astype(np.float32)
        weights[rng.random(shape[:2]) < 0.4] = 0
        words["weights"] = weights
    if special == "positions":
        v, u = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in shape[:2]), indexing="ij")
        words["positions"] = np.stack((v, u), -1) + rng.normal(0, 0.2, (*shape[:2], 2))
    if special == "spacing":
        words["spacing"] = (-2e-3, -1e-3, 20e-6, 15e-6)
    return clplen.LightField.from_array(data, **words)


def depth_of(lf: clplen.LightField) -> clplen.DepthMap:
    """A map of some disparities, smooth."""
    y, x = np.indices(lf.shape[2:4])
    d = np.float32(0.8 * np.sin(0.2 * y + 0.13 * x) + 0.01 * x)
    unknown = np.full_like(d, np.nan)
    return clplen.DepthMap(d, unknown, unknown, np.ones_like(d))


def state_of(name: str, shape: tuple[int, ...], white: float) -> dict[str, Any]:
    """A state of the viewer for views of a shape, of which 0 is black and another value white."""
    state = {"d": 0.0, "sharp": False, "curve": "linear"} | STATES[name]
    state |= {level: state.get(level, share) * white for level, share in _SHARES.items()}
    for axis, n in zip("vu", shape[:2], strict=True):
        state[axis] = round(state.get(axis, 0.5) * (n - 1), 2)
    state["across"] = min(state.get("across", 1), max(shape[:2]))
    return state


def computed(lf: clplen.LightField, state: dict[str, Any]) -> np.ndarray[Any, Any]:
    """The picture of a state, by clplen."""
    at = (state["v"], state["u"])
    d = depth_of(lf).disparity if state["sharp"] else state["d"]
    if state["shape"] == "all":
        return clplen.refocus(lf, disparity=d).to_numpy()
    if state["shape"] == "one":
        return lf.view(*at, disparity=d).to_numpy()
    centred = all(x == (n - 1) / 2 for x, n in zip(at, lf.shape, strict=False))
    aperture = state["diameter"] if state["shape"] == "disc" else int(state["across"])
    words = {"aperture": aperture, "viewpoint": None if centred else at}
    return lf.flatten(disparity=d, **words).to_numpy()


def levels(picture: np.ndarray[Any, Any], state: dict[str, Any]) -> np.ndarray[Any, Any]:
    """RGB levels of a picture as a state shows it."""
    black, white = state["black"], state["white"]
    part = np.clip((picture.astype(np.float64) - black) / (white - black), 0, 1)
    if state["curve"] == "srgb":  # IEC 61966-2-1:1999
        part = np.where(part <= 0.0031308, 12.92 * part, 1.055 * part ** (1 / 2.4) - 0.055)
    elif state["curve"] == "log":
        part = np.log1p(999 * part) / np.log(1000)
    elif state["curve"] == "gamma":
        part = part ** (1 / state["gamma"])
    part = np.rint(255 * part)
    return part if part.ndim == 3 else np.repeat(part[..., None], 3, axis=2)


def decoded(url: str) -> np.ndarray[Any, Any]:
    """RGB levels of a data URL."""
    with Pillow.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))) as picture:
        return np.asarray(picture.convert("RGB"), np.float64)


@contextmanager
def browser() -> Iterator[Any]:
    """A Chromium without a network."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


def open_page(opened: Any, path: Path | str, **options: Any) -> Any:
    """A page that is loaded and shows its first item."""
    page = opened.new_context(offline=True, **options).new_page()
    page.goto(path.as_uri() if isinstance(path, Path) else path)
    page.evaluate(READY)
    return page


def differences(opened: Any, folder: Path, name: str) -> dict[str, tuple[float, float]]:
    """Largest differences of the canvas and of the saved picture, for each state."""
    lf = light_field(name)
    path = folder / "page.html"
    clplen.io.write_html(path, lf, depth=depth_of(lf))
    page = open_page(opened, path, viewport={"width": 900, "height": 700})
    white = page.evaluate("window.clplen.view.state.white")
    found = {}
    for label in STATES:
        state = state_of(label, lf.shape, white)
        canvas, saved = page.evaluate(_CANVAS, state)
        wanted = levels(computed(lf, state), state)
        found[label] = tuple(float(np.abs(decoded(url) - wanted).max()) for url in (canvas, saved))
    page.context.close()
    return found
