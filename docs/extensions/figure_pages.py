"""The gallery: a page a figure script, and the directive ``figure-cards`` whose cards lead there.

A figure's title is its script's docstring, its numbers the row of the table in examples/README.md,
its picture and run time those of gallery/make_pictures.py.
"""

from __future__ import annotations

import ast
import json
import re
from dataclasses import dataclass
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from written import remove_others, write_page

DOCS = Path(__file__).parents[1]
EXAMPLES = DOCS.parent / "examples"
PICTURES = DOCS / "gallery" / "pictures"
_ROW = re.compile(r"\| (.+?) \| \[(\w+)\.py\]\(.+?\)[^|]* \| (.+?) \| (.+?) \|$", re.MULTILINE)


@dataclass(frozen=True)
class Figure:
    """A script that draws, and what is known of it."""

    script: str  # name without suffix
    short: str  # as the table calls it
    number: str
    reference: str
    title: str
    seconds: float
    quick: bool  # the picture is that of a smaller computation

    @property
    def shows(self) -> str:
        """Its title without the number."""
        words = re.sub(r"^Figure [\d.]+: ", "", self.title)
        return words[:1].upper() + words[1:]

    @property
    def chapter(self) -> str:
        """The chapter of the thesis, or "frames"."""
        return self.script.split("_")[1] if self.script.startswith("fig_") else "frames"


def figures() -> list[Figure]:
    """All of them in the order of the table."""
    runs = json.loads((DOCS / "gallery" / "runs.json").read_text(encoding="utf-8"))
    table = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    found = []
    for short, script, number, reference in _ROW.findall(table):
        code = (EXAMPLES / f"{script}.py").read_text(encoding="utf-8")
        title = " ".join((ast.get_docstring(ast.parse(code)) or "").split("\n\n")[0].split())
        if not (PICTURES / f"{script}.webp").is_file():
            continue  # a script that prints numbers and draws nothing
        run = runs[script]
        title = title.rstrip(".")
        figure = Figure(script, short, number, reference, title, run["seconds"], run["quick"])
        found.append(figure)
    return found


def _links(text: str) -> str:
    """Text of the table with its links led to the examples."""
    text = re.sub(r"\]\((?!http|#|\.\.)", "](../../../examples/", text)
    return text.replace("](../docs/", "](../../")


def figure_page(figure: Figure) -> str:
    """The page of a figure, in Markdown."""
    lasted = f"{figure.seconds:.0f} s on two cores" + ", with `--quick`" * figure.quick
    return f"""# {figure.title}

![{figure.short}](../pictures/{figure.script}.webp)

| | |
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
        lines = ["::::{grid} 1 2 3 4", ":gutter: 2", ""]
        for figure in figures():
            if figure.chapter == self.arguments[0]:
                lines += [
                    f":::{{grid-item-card}} {figure.short}",
                    f":link: figures/{figure.script}",
                    ":link-type: doc",
                    f":img-top: pictures/{figure.script}.webp",
                    f":img-alt: {figure.title}",
                    "",
                    f"{figure.shows}. *{figure.seconds:.0f} s.*",
                    ":::",
                ]
        lines.append("::::")
        node = nodes.container()
        node.document = self.state.document
        self.state.nested_parse(StringList(lines, "figure-cards"), self.content_offset, node)
        return [node]


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
    return {"parallel_read_safe": True, "parallel_write_safe": True}
