"""Pages of the viewer looked at: every mode as a screenshot, its contrast, its size and its time.

    python benchmarks/viewer_pages.py -o FOLDER [--axe node_modules/axe-core/axe.min.js]

writes a page of each kind, a screenshot of each mode 1280 and 375 pixels wide, light and dark, and
prints what axe-core (`npm install axe-core`) finds against WCAG 2.1 AA; then size and first picture
of the pages of a captured light field (`$CLPLEN_DATA`) and of 9 x 9 x 512 x 512 x 3 samples. Needs
Chromium and playwright as accuracy_viewer.py does.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from accuracy_viewer import READY, browser, open_page

import clplen

WIDTHS = {1280: 760, 375: 812}
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]
# Modes: the page, and the state that shows it.
MODES: dict[str, tuple[str, dict[str, Any]]] = {
    "viewpoint": ("scene", {}),
    "focus": ("scene", {"shape": "all", "d": 0.9}),
    "disc": ("scene", {"shape": "disc", "diameter": 0.6, "v": 2.5, "u": 4.5}),
    "depth": ("scene", {"depth": True}),
    "all in focus": ("scene", {"shape": "all", "sharp": True}),
    "views": ("scene", {"show": "views"}),
    "slices": ("scene", {"show": "slices"}),
    "raw": ("camera", {"show": "raw"}),
    "stack": ("stack", {"z": 5}),
    "volume": ("volume", {}),
    "maximum": ("volume", {"projection": "maximum", "table": "magma"}),
    "map": ("map", {}),
    "compare": ("compare", {}),
    "gamma": ("scene", {"curve": "gamma"}),
}
_FIRST = """
(start) => new Promise((done) => {
  const look = () => window.clplen?.view?.loaded
    ? requestAnimationFrame(() => done(performance.now())) : setTimeout(look, 5);
  look();
})
"""


def scene() -> clplen.LightField:
    """Three textured planes one behind the other, as 9 x 9 views in colour."""
    rng = np.random.default_rng(2)
    size, V = 200, 9
    y, x = np.indices((size, size)).astype(float)
    noise = [_smooth(rng, size) for _ in range(3)]
    a = np.empty((V, V, size, size, 3), np.float32)
    for v in range(V):
        for u in range(V):
            out = np.zeros((size, size, 3))
            for d, texture, where, tint in (
                (-0.8, noise[0], lambda *_: True, (0.5, 0.65, 0.9)),
                (0.1, noise[1], lambda b, c: np.hypot(b - 95, c - 70) < 48, (0.95, 0.75, 0.4)),
                (1.0, noise[2], lambda b, c: np.hypot(b - 120, c - 135) < 34, (0.9, 0.4, 0.5)),
            ):
                b, c = y + (v - 4) * d, x + (u - 4) * d
                inside = np.broadcast_to(where(b, c), y.shape)
                shade = texture[np.rint(b).astype(int) % size, np.rint(c).astype(int) % size]
                out[inside] = (shade[..., None] * np.array(tint))[inside]
            a[v, u] = out
    values = np.rint(255 * np.clip(a, 0, 1)).astype(np.uint8)
    return clplen.LightField.from_array(values, spacing=(-1e-3, -1e-3, 60e-6, 60e-6))


def _smooth(rng: np.random.Generator, size: int) -> np.ndarray[Any, Any]:
    """Noise of all scales, 0.2 to 1, periodic."""
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    spectrum = np.fft.fft2(rng.normal(size=(size, size))) / (f + 0.02) ** 0.9
    values = np.fft.ifft2(spectrum).real
    return 0.2 + 0.8 * (values - values.min()) / np.ptp(values)


def camera() -> clplen.LightField:
    """Three points before a plenoptic camera, with the raw image."""
    lenslets = clplen.MicrolensArray(150e-6, 10e-3, count=53, fill="full")
    cam = clplen.PlenopticCamera.type1(
        focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=15
    )
    points = [(-2e-3, -1e-3, -50e-3), (0.0, 0.0, 0.0), (2e-3, 2e-3, 50e-3)]
    return clplen.LightField.from_raw(cam.expose(clplen.PointSources(points)))


def volume() -> np.ndarray[Any, Any]:
    """Beads of several sizes."""
    z, y, x = np.indices((24, 120, 150)).astype(float)
    rng = np.random.default_rng(4)
    out = np.zeros(z.shape)
    for _ in range(25):
        at = rng.uniform((3, 8, 8), (21, 112, 142))
        r2 = ((z - at[0]) / 1.2) ** 2 + (y - at[1]) ** 2 + (x - at[2]) ** 2
        out += rng.uniform(0.3, 1) * np.exp(-r2 / rng.uniform(4, 25))
    return out.astype(np.float32)


def write_pages(folder: Path) -> None:
    """One page of each kind."""
    lf = scene()
    depth = clplen.depth_map(lf)
    energy = clplen.depth_map(lf, cue="energy")
    stack = clplen.focal_stack(lf, disparities=np.linspace(-1.5, 1.5, 11))
    pages: dict[str, Any] = {
        "scene": {"planes": lf},
        "camera": {"points": camera()},
        "stack": {"stack": stack},
        "volume": {"beads": volume()},
        "map": {"depth": depth},
    }
    for name, subject in pages.items():
        words = {"depth": depth} if name == "scene" else {}
        clplen.io.write_html(folder / f"{name}.html", subject, title=name, **words)
    both = {"combined": depth, "energy": energy}
    clplen.io.write_html(folder / "compare.html", both, title="cues", compare=True)


def look(opened: Any, folder: Path, axe: Path | None) -> int:
    """Screenshots of all modes; how many violations axe-core found."""
    found = 0
    for mode, (name, state) in MODES.items():
        for width, height in WIDTHS.items():
            for scheme in ("light", "dark"):
                size = {"width": width, "height": height}
                path = folder / f"{name}.html"
                page = open_page(opened, path, viewport=size, color_scheme=scheme, bypass_csp=True)
                page.evaluate("(s) => clplen.view.change?.(s)", state)
                page.wait_for_timeout(400)
                shot = folder / f"{mode} {width} {scheme}.png"
                page.screenshot(path=shot, full_page=width < 700)
                if axe is not None:
                    found += _violations(page, axe, f"{mode} {width} {scheme}")
                page.context.close()
    return found


def _violations(page: Any, axe: Path, where: str) -> int:
    page.add_script_tag(path=str(axe))
    run = f"axe.run({{runOnly: {RULES}}}).then((r) => r.violations)"
    violations = page.evaluate(run)
    for violation in violations:
        for node in violation["nodes"]:
            print(f"{where}: {violation['id']}: {node['html'][:90]}: {node['failureSummary']}")
    return len(violations)


def measure(opened: Any, path: Path, subject: clplen.LightField, words: dict[str, Any]) -> str:
    """Size and times of the page of a light field."""
    start = time.perf_counter()
    clplen.io.write_html(path, subject, **words)
    written = time.perf_counter() - start
    page = opened.new_context(offline=True).new_page()
    asked: list[str] = []
    page.on("request", lambda r: asked.append(r.url))
    page.goto(path.as_uri(), wait_until="commit")
    first = page.evaluate(_FIRST)
    parsed = page.evaluate("performance.getEntriesByType('navigation')[0].domInteractive")
    page.evaluate(READY)
    ready = page.evaluate("performance.now()")
    # every picture is read back, which waits until it is drawn
    drawn = page.evaluate(
        "() => { const view = clplen.view; view.change({shape: 'all', d: 0.31});"
        " const start = performance.now(); view.change({d: 0.32}); view.settle();"
        " return performance.now() - start; }"
    )
    network = [url for url in asked if not url.startswith(("data:", "blob:", "file:"))]
    page.context.close()
    return (
        f"{path.stat().st_size / 1e6:6.1f} MB, written in {written:.1f} s, {len(network)} "
        f"requests, first picture {first:.0f} ms after the start ({first - parsed:.0f} ms after "
        f"the page has its data), all views after {ready:.0f} ms, exact picture of all views in "
        f"{drawn:.0f} ms"
    )


@click.command()
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path))
@click.option("--axe", type=click.Path(path_type=Path), help="axe.min.js of axe-core.")
@click.option("--only", type=click.Choice(["look", "sizes"]))
def main(output: Path, axe: Path | None, only: str | None) -> None:
    output.mkdir(parents=True, exist_ok=True)
    with browser() as opened:
        if only != "sizes":
            write_pages(output)
            found = look(opened, output, axe)
            said = "not asked" if axe is None else f"{found} violations"
            print(f"{4 * len(MODES)} screenshots in {output}; axe-core: {said}")
        if only != "look":
            data = Path(os.environ.get("CLPLEN_DATA", "../shared/data")) / "lytro_f01_flower"
            if data.is_dir():
                flower = clplen.read_lightfield(data, pattern="IMG_0001_{n}_{u}_{v}.png")
                depth = clplen.depth_map(flower)
                print("flower", measure(opened, output / "flower.html", flower, {"depth": depth}))
            tile = np.tile(scene().to_numpy(), (1, 1, 3, 3, 1))[..., :512, :512, :]
            large = clplen.LightField.from_array(np.ascontiguousarray(tile))
            print("9 x 9 x 512 x 512 x 3", measure(opened, output / "large.html", large, {}))
            words = {"quality": 90}
            print("  as JPEG of 90", measure(opened, output / "jpeg.html", large, words))


if __name__ == "__main__":
    main()
