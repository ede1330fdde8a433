"""Take screenshots of the site: python docs/tools/screenshots.py site -o FOLDER"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

PAGES = (
    "index",
    "start/install",
    "gallery/index",
    "gallery/figures/fig_3_21_refocus_triplet",
    "reference/api/clplen",
    "reference/api/generated/clplen.refocus",
    "reference/api/generated/clplen.LightField",
    "reference/commands/depth",
    "reference/toml",
    "tutorials/partial_coherence",
    "howto/refocus_in_metres",
    "quality/how_known",
)
WIDTHS = (1280, 375)


def main() -> None:
    """Read the command line, open each page at each width."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("screenshots"))
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=os.environ.get("CLPLEN_CHROMIUM", "/usr/bin/chromium"),
            args=["--no-sandbox"],
        )
        for width in WIDTHS:
            page = browser.new_page(viewport={"width": width, "height": 900})
            for name in PAGES:
                page.goto((given.site / f"{name}.html").resolve().as_uri())
                page.wait_for_timeout(300)
                wide = page.evaluate("document.documentElement.scrollWidth")
                if wide > width:
                    print(f"{name} is {wide} px wide at {width} px")
                page.screenshot(path=given.output / f"{name.replace('/', '_')}_{width}.png")
            page.close()
        browser.close()


if __name__ == "__main__":
    main()
