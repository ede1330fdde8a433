"""Ask the site's own search what users ask: python docs/tools/search.py site

The tool types each question into the search page in Chromium. A page that answers it must be among
the first three hits. Questions without an answering page in the site are skipped.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any
from urllib.parse import quote_plus

QUESTIONS = {
    "refocus to a depth in metres": ("howto/refocus_in_metres",),
    "white image not found": ("howto/white_image_not_found",),
    "add a lens aberration": ("howto/add_an_aberration",),
    "export to ImageJ": ("howto/napari_and_fiji",),
    "use my GPU": ("howto/use_a_gpu",),
    "load MATLAB light field": ("howto/matlab_and_numpy",),
    "out of memory": ("howto/larger_than_memory",),
    "views in wrong order": ("howto/views_in_wrong_order",),
    "point cloud from depth map": ("howto/point_cloud",),
    "change pixel size of the output plane": ("howto/choose_the_output_grid",),
    "partially coherent LED": ("howto/led_and_partial_coherence",),
    "Lytro": ("formats", "howto/lytro_files"),
    "is my propagation sampled finely enough": ("sampling", "howto/choose_the_output_grid"),
    "cite clplen": ("development/cite", "start/cite"),
    "OpenCL device not found": ("devices", "howto/use_a_gpu", "start/install"),
    "white balance and demosaicing": ("calibration", "real_cameras"),
    "deconvolve light-field microscope": ("microscope", "tutorials/microscope"),
    "batch many files on a cluster": ("batch", "tutorials/batch", "scaling"),
    "how accurate is it": ("quality/how_known", "accuracy"),
    "view a light field in a notebook": ("viewer",),
    "PSF of a lens with defocus": ("howto/psf_of_a_lens",),
    "4f system with a filter": ("howto/four_f_filter",),
    "Fourier optics course": ("tutorials/fourier_optics",),
    "in-line hologram": ("howto/inline_hologram",),
    "compare two designs": ("howto/compare_designs",),
    "open a result in napari": ("howto/napari_and_fiji",),
    "open a stack in Fiji": ("howto/napari_and_fiji",),
    "light field from a phone video": ("howto/phone_or_slider",),
    "camera on a slider rail": ("howto/phone_or_slider",),
    "teaching exercises with solutions": ("tutorials/exercises",),
}
FIRST = 3


def hits(page: Any, site: Path, question: str) -> list[str]:
    """Pages that the search names, best first."""
    page.goto(f"{(site / 'search.html').resolve().as_uri()}?q={quote_plus(question)}")
    page.wait_for_function(
        "() => /found|did not match|matching/i.test("
        "document.querySelector('#search-results p.search-summary, #search-results h2 + p')"
        "?.textContent || '')",
        timeout=20_000,
    )
    links = page.eval_on_selector_all("#search-results li > a", "all => all.map((a) => a.href)")
    root = site.resolve().as_uri() + "/"
    pages = [link.removeprefix(root).partition(".html")[0] for link in links]
    return list(dict.fromkeys(pages))


def main() -> None:
    """Print the first hits of every question; the exit status is 1 if an answer is not there."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path)
    site = parser.parse_args().site
    missed = 0
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=os.environ.get("CLPLEN_CHROMIUM", "/usr/bin/chromium"),
            args=["--no-sandbox"],
        )
        page = browser.new_page()
        questions = {question: answers for question, answers in QUESTIONS.items()
                     if any((site / f"{answer}.html").is_file() for answer in answers)}  # fmt: skip
        for question, answers in questions.items():
            first = hits(page, site, question)[:FIRST]
            answered = any(answer in first for answer in answers)
            missed += not answered
            print(f"{'' if answered else 'MISSED '}{question}: {', '.join(first) or 'no hit'}")
        browser.close()
    skipped = len(QUESTIONS) - len(questions)
    print(f"{len(questions)} questions, {skipped} skipped, {missed} not in the first {FIRST} hits")
    raise SystemExit(bool(missed))


if __name__ == "__main__":
    main()
