"""Gallery: a page for each figure script, and the directive ``figure-cards`` that links to them.

The title of a figure is the docstring of its script. Its numbers come from examples/README.md, its
picture and run time from gallery/make_pictures.py, its subjects from gallery/thumbnails.toml.
"""

from __future__ import annotations

import ast
import html
import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from written import remove_others, write_page

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DOCS = Path(__file__).parents[1]
EXAMPLES = DOCS.parent / "examples"
PICTURES = DOCS / "gallery" / "pictures"
_ROW = re.compile(r"\| (.+?) \| \[(\w+)\.py\]\(.+?\)[^|]* \| (.+?) \| (.+?) \|$", re.MULTILINE)


@dataclass(frozen=True)
class Figure:
    """A figure script with its title, numbers and run time."""

    script: str  # name without suffix
    short: str  # as the table calls it
    number: str
    reference: str
    title: str
    seconds: float
    quick: bool  # True if the picture shows the smaller computation of --quick
    label: str  # caption of its card
    subjects: tuple[str, ...]  # keys of [subjects] in gallery/thumbnails.toml

    @property
    def shows(self) -> str:
        """Its title without the number."""
        title = re.sub(r"^Figure [\d.]+: ", "", self.title)
        return title[:1].upper() + title[1:]

    @property
    def chapter(self) -> str:
        """The chapter of the thesis, or "frames"."""
        return self.script.split("_")[1] if self.script.startswith("fig_") else "frames"


def thumbnail_settings() -> dict[str, Any]:
    """Return boxes and subjects of the thumbnails, and the names of the subjects."""
    return tomllib.loads((DOCS / "gallery" / "thumbnails.toml").read_text(encoding="utf-8"))


def figures() -> list[Figure]:
    """Return all figures in the order of the table in examples/README.md."""
    thumbnails = thumbnail_settings()
    runs = json.loads((DOCS / "gallery" / "runs.json").read_text(encoding="utf-8"))
    table = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    entries = []
    for short, script, number, reference in _ROW.findall(table):
        code = (EXAMPLES / f"{script}.py").read_text(encoding="utf-8")
        title = " ".join((ast.get_docstring(ast.parse(code)) or "").split("\n\n")[0].split())
        if not (PICTURES / f"{script}.webp").is_file():
            continue  # a script that prints numbers and draws nothing
        run = runs[script]
        title = title.rstrip(".")
        settings = thumbnails[script]
        stem = re.sub(r"^[\d.]+ ", "", short)
        label = settings.get("label", stem[:1].upper() + stem[1:])
        subjects = tuple(settings["subjects"])
        figure = Figure(
            script, short, number, reference, title, run["seconds"], run["quick"], label, subjects
        )
        entries.append(figure)
    return entries


def _links(text: str) -> str:
    """Text of the table with its links led to the examples."""
    text = re.sub(r"\]\((?!http|#|\.\.)", "](../../../examples/", text)
    return text.replace("](../docs/", "](../../")


def figure_page(figure: Figure) -> str:
    """The page of a figure, in Markdown."""
    lasted = f"{figure.seconds:.0f} s on two cores" + ", with `--quick`" * figure.quick
    return f"""# {figure.title}

![{figure.short}](../pictures/{figure.script}.webp)

| quantity | value |
|---|---|
| printed number | {_links(figure.number)} |
| reference | {_links(figure.reference)} |
| run time of the picture | {lasted} |

```
python examples/{figure.script}.py
```

```{{literalinclude}} ../../../examples/{figure.script}.py
:language: python
```
"""


class FigureCards(Directive):
    """Cards of the figures of a chapter."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        lines = ["::::{grid} 2 3 4 4", ":gutter: 2", ":class-container: gallery", ""]
        for figure in figures():
            if figure.chapter == self.arguments[0]:
                lines += card(figure, folder="figures")
        node = nodes.container()
        node.document = self.state.document
        settings = self.state.document.settings
        settings.record_dependencies.add(str(DOCS / "gallery" / "thumbnails.toml"))
        lines = [*lines, "::::"]
        self.state.nested_parse(StringList(lines, "figure-cards"), self.content_offset, node)
        return [node]


def card(figure: Figure, folder: str) -> list[str]:
    """Return the lines of a card that links to a figure's page in ``folder``."""
    classes = " ".join(f"subject-{subject}" for subject in figure.subjects)
    return [
        f":::{{grid-item-card}} {figure.label}",
        f":link: {folder}/{figure.script}",
        ":link-type: doc",
        f":link-alt: {figure.shows}",
        f":img-top: /gallery/thumbnails/{figure.script}.webp",
        f":img-alt: {figure.title}",
        f":class-item: {classes}",
        ":::",
    ]


class FigureFilter(Directive):
    """Buttons that filter the gallery by subject (static/site.js)."""

    def run(self) -> list[nodes.Node]:
        subjects = {"": "All", **thumbnail_settings()["subjects"]}
        buttons = [
            f'<button type="button" data-subject="{key}" aria-pressed="false">'
            f"{html.escape(name)}</button>"
            for key, name in subjects.items()
        ]
        buttons[0] = buttons[0].replace("false", "true")
        count = len(figures())
        text = f'<div class="gallery-filter">{"".join(buttons)}</div>'
        text += f'<p class="gallery-count" role="status">{count} of {count} figures</p>'
        return [nodes.raw("", text, format="html")]


def write_pages(app: Sphinx, _config: object) -> None:
    """Write the page of every figure."""
    folder = Path(app.srcdir, "gallery", "figures")
    pages = {folder / f"{figure.script}.md": figure_page(figure) for figure in figures()}
    for path, text in pages.items():
        write_page(path, text)
    remove_others(folder, set(pages))


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("config-inited", write_pages)
    app.add_directive("figure-cards", FigureCards)
    app.add_directive("figure-filter", FigureFilter)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
