"""Page of a comparison: its conclusions above six pictures."""

from __future__ import annotations

import html
import re
from base64 import b64encode
from collections.abc import Mapping

from clplen.analysis.cameras.comparison import Comparison
from clplen.analysis.report.summary import criteria, depth_verdicts, judge

# The figures of the page, those that a reader of a design looks at first
FIGURES = {
    "pictures": "Rendered pictures of the scene",
    "psf": "Image of a point",
    "mtf": "Contrast over frequency",
    "two-points": "Contrast between two points",
    "transfer": "Resolution over depth",
    "depth": "Error of depth",
}
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 76rem; padding: 0 1rem }
div { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fit, minmax(22rem, 1fr)) }
figure { margin: 0 } img { width: 100%; background: white } code { font-size: 0.95em }
"""


def page(comparison: Comparison, figures: Mapping[str, bytes]) -> str:
    """Return a page in HTML from figures in PNG by name; it needs no other file.

    The conclusions are those of `report`. Figures of analyses that were left out are missing.
    """
    title = "Comparison of plenoptic cameras"
    conclusions = [judge(criterion, comparison.cameras) for criterion in criteria(comparison)]
    conclusions += [f"**usable MTF50** {line}" for line in depth_verdicts(comparison)]
    items = "\n".join(f"<li>{_formatted(text)}</li>" for text in conclusions)
    pictures = "\n".join(
        f'<figure><img alt="{caption}" src="data:image/png;base64,'
        f'{b64encode(figures[name]).decode()}"><figcaption>{caption}</figcaption></figure>'
        for name, caption in FIGURES.items()
        if name in figures
    )
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head>\n<body><h1>{title}</h1>\n<ul>\n{items}\n</ul>\n"
        f"<div>\n{pictures}\n</div></body></html>\n"
    )


def _formatted(text: str) -> str:
    """Return a sentence in HTML; names in backquotes are code, names in asterisks are bold."""
    escaped = html.escape(text)
    code = re.sub(r"`([^`]*)`", r"<code>\1</code>", escaped)
    return re.sub(r"\*\*([^*]*)\*\*", r"<strong>\1</strong>", code)
