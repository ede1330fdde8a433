"""Look at pages of the built site in Chromium: python docs/tools/pages.py site [-o FOLDER]

For each page and width, this checks that nothing is wider than the screen, that code is whole or
scrolls, and that axe-core finds no fault ($CLPLEN_AXE names axe.min.js). It prints the time of the
first paint, the layout shift and the weight, and writes screenshots in light and dark to FOLDER.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

PAGES = (
    "index",
    "start/install",
    "tutorials/index",
    "tutorials/captured",
    "howto/index",
    "howto/refocus_in_metres",
    "gallery/index",
    "gallery/figures/fig_3_21_refocus_triplet",
    "reference/api/clplen",
    "reference/api/generated/clplen.refocus",
    "reference/api/generated/clplen.LightField",
    "reference/api/generated/clplen.plot.depth",
    "reference/commands/depth",
    "reference/toml",
    "quality/how_known",
    "search",
)
SIZES = ((1280, 900), (375, 812))
MAX_SHIFT = 0.1  # layout shift that web.dev calls good
# Elements that leave the screen although nothing around them scrolls
CUT = """() => {
  const width = document.documentElement.clientWidth;
  const scrolls = (e) => e && e.tagName !== "BODY" &&
    (/auto|scroll/.test(getComputedStyle(e).overflowX) || scrolls(e.parentElement));
  const all = [...document.querySelectorAll("article pre, article table, article img, article p")];
  return all.filter((e) => e.getBoundingClientRect().right > width + 1 && !scrolls(e.parentElement))
    .map((e) => `${e.tagName}: ${(e.innerText || e.src).slice(0, 40)}`)
    .concat(all.filter((e) => e.tagName === "PRE" && e.scrollWidth > e.clientWidth + 1)
      .filter((e) => !scrolls(e))
      .map((e) => `code: ${e.innerText.slice(0, 40)}`));
}"""
SHIFTS = """window.shift = 0; new PerformanceObserver((list) => {
  for (const entry of list.getEntries()) if (!entry.hadRecentInput) window.shift += entry.value;
}).observe({type: "layout-shift", buffered: true});"""
FIGURES = """() => ({
  paint: performance.getEntriesByName("first-contentful-paint")[0]?.startTime,
  shift: window.shift,
})"""


def faults(page: Any, width: int) -> list[str]:
    """Return a sentence for each fault of the open page."""
    wide = page.evaluate("document.documentElement.scrollWidth")
    sentences = [f"is {wide} px wide"] if wide > width else []
    sentences += [f"cuts {element}" for element in page.evaluate(CUT)]
    axe = os.environ.get("CLPLEN_AXE")
    if axe and Path(axe).is_file():
        page.add_script_tag(path=axe)
        for violation in page.evaluate("axe.run()")["violations"]:
            target = violation["nodes"][0]["target"]
            sentences.append(f"breaks {violation['id']} of axe at {target}")
    return sentences


def filter_faults(page: Any) -> list[str]:
    """Press each button of the gallery by keyboard; return a sentence for each wrong count."""
    sentences = []
    for button in page.query_selector_all(".gallery-filter button"):
        button.focus()
        page.keyboard.press("Enter")
        count = page.inner_text(".gallery-count").split()[0]
        visible = page.locator(".gallery [class*='subject-']:visible").count()
        if visible != int(count):
            name = button.inner_text()
            sentences.append(f"shows {visible} figures, and counts {count} of {name}")
    return sentences


def weight(files: list[str]) -> int:
    """Return the bytes of local files."""
    paths = {
        Path(name.partition("#")[0].partition("?")[0].removeprefix("file://")) for name in files
    }
    return sum(path.stat().st_size for path in paths if path.is_file())


def main() -> None:
    """Check each page at each width; the exit status is 1 if there are faults."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="folder of screenshots")
    parser.add_argument("--all", action="store_true", help="every page, not only one of each kind")
    arguments = parser.parse_args()
    site = arguments.site.resolve()
    names = PAGES
    if arguments.all:
        files = [path.relative_to(site) for path in site.rglob("*.html")]
        names = sorted(str(f.with_suffix("")) for f in files if f.parts[0] != "_static")
    count = 0
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=os.environ.get("CLPLEN_CHROMIUM", "/usr/bin/chromium"),
            args=["--no-sandbox"],
        )
        for width, height in SIZES:
            for mode in ("light", "dark"):
                size = {"width": width, "height": height}
                context = browser.new_context(viewport=size, color_scheme=mode)
                context.add_init_script(SHIFTS)
                page = context.new_page()
                files: list[str] = []
                page.on("request", lambda request, files=files: files.append(request.url))
                for name in names:
                    files.clear()
                    page.goto((site / f"{name}.html").as_uri())
                    page.wait_for_timeout(300)
                    figures = page.evaluate(FIGURES)
                    if figures["shift"] > MAX_SHIFT:  # a busy machine delays the style sheets
                        page.reload()
                        page.wait_for_timeout(300)
                        figures = page.evaluate(FIGURES)
                    if arguments.output:
                        arguments.output.mkdir(parents=True, exist_ok=True)
                        file = f"{name.replace('/', '_')}_{width}_{mode}.png"
                        page.screenshot(path=arguments.output / file)
                    sentences = faults(page, width) + filter_faults(page)
                    if figures["shift"] > MAX_SHIFT:
                        sentences.append("shifts while it loads")
                    count += len(sentences)
                    where = f"{name} at {width} px, {mode}"
                    for sentence in sentences:
                        print(f"{where} {sentence}")
                    paint, kilobytes = figures["paint"] or 0, weight(files) / 1e3
                    print(f"{where}: first paint {paint:.0f} ms, shift {figures['shift']:.3f}, "
                          f"{kilobytes:.0f} kB")  # fmt: skip
                context.close()
        browser.close()
    print(f"{len(names)} pages, {count} faults")
    raise SystemExit(bool(count))


if __name__ == "__main__":
    main()
