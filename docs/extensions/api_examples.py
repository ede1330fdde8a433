"""Pictures and related pages of the API: the directive ``api-examples`` and sections See Also.

The directive shows the picture of a call in images/plots.toml, thumbnails of the gallery figures
that use the name, and links to the tutorials and guides that use it.
"""

from __future__ import annotations

import ast
import functools
import importlib
import re
import sys
from collections.abc import Iterator
from typing import Any

from api_pages import unique_names
from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from figure_pages import DOCS, EXAMPLES, Figure, figures
from sphinx.application import Sphinx

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_FIGURES = 4
MAX_GUIDES = 6
GUIDES = ("tutorials/*.md", "howto/*.md", "start/*.md", "*.md")
_BLOCK = re.compile(r"^```(?:\{code-cell\} ipython3|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def _paths_of_tree(tree: ast.AST) -> Iterator[str]:
    """Yield the dotted paths below clplen that code names."""
    aliases = {"clplen": "clplen"}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "clplen":
            for alias in node.names:
                aliases[alias.asname or alias.name] = f"{node.module}.{alias.name}"
    yield from aliases.values()
    for node in ast.walk(tree):
        parts: list[str] = []
        while isinstance(node, ast.Attribute):
            parts.append(node.attr)
            node = node.value
        if parts and isinstance(node, ast.Name) and node.id in aliases:
            yield ".".join([aliases[node.id], *reversed(parts)])


@functools.cache
def documented() -> dict[int, str]:
    """Return the documented path of each public object by its identity."""
    paths = [path for group in unique_names().values() for path in group]
    return {id(_resolve(path)): path for path in paths}


@functools.cache
def _resolve(path: str) -> Any:
    """Return the object of a dotted path, or None."""
    module, _, name = path.rpartition(".")
    try:
        owner = _resolve(module) if "." in module else importlib.import_module(module)
        return getattr(owner, name, None)
    except ImportError:  # a bridge whose library is not installed
        return None


def names_in(code: str) -> set[str]:
    """Return the documented paths of the public objects that code uses."""
    try:
        paths = set(_paths_of_tree(ast.parse(code)))
    except SyntaxError:  # cell magics
        return set()
    public = documented()
    prefixes = {".".join(path.split(".")[:n]) for path in paths for n in range(2, 5)} - {"clplen"}
    return {public[id(value)] for path in prefixes
            if (value := _resolve(path)) is not None and id(value) in public}  # fmt: skip


@functools.cache
def figures_by_name() -> dict[str, list[Figure]]:
    """Return the figures whose scripts use each name, in the order of the gallery."""
    users: dict[str, list[Figure]] = {}
    for figure in figures():
        code = (EXAMPLES / f"{figure.script}.py").read_text(encoding="utf-8")
        for module in re.findall(r"^from (\w+) import", code, re.MULTILINE):
            file = EXAMPLES / f"{module}.py"
            if file.is_file() and module not in ("common", "drawing"):
                code += "\n" + re.sub(r"^from __future__.*", "", file.read_text(encoding="utf-8"))
        code = code.replace("from __future__ import annotations", "")
        for name in names_in(code):
            users.setdefault(name, []).append(figure)
    return users


@functools.cache
def guides_by_name() -> dict[str, list[str]]:
    """Return the pages whose code blocks use each name, tutorials first."""
    users: dict[str, list[str]] = {}
    for pattern in GUIDES:
        for file in sorted(DOCS.glob(pattern)):
            page = file.relative_to(DOCS).with_suffix("").as_posix()
            if page == "index":
                continue
            blocks = _BLOCK.findall(file.read_text(encoding="utf-8"))
            for name in {name for block in blocks for name in names_in(block)}:
                users.setdefault(name, []).append(page)
    return users


@functools.cache
def related_names() -> dict[str, list[str]]:
    """Return the names that reference/related.toml groups with each name."""
    groups = tomllib.loads((DOCS / "reference" / "related.toml").read_text(encoding="utf-8"))
    related: dict[str, list[str]] = {}
    for names in groups.values():
        for name in names:
            others = related.setdefault(name, [])
            others += [other for other in names if other != name and other not in others]
    return related


def add_see_also(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Add a section See Also to a docstring that has none."""
    names = related_names().get(name)
    if names and "See Also" not in lines:
        lines += ["", "See Also", "--------", ", ".join(names), ""]


def _is_direct(figure: Figure, short: str) -> bool:
    """Return True if the script of a figure itself, or its name, holds a short name."""
    code = (EXAMPLES / f"{figure.script}.py").read_text(encoding="utf-8")
    return re.search(rf"\b{short}\(", code) is not None or short in figure.script


class ApiExamples(Directive):
    """Pictures and pages that use a public name."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        lines: list[str] = []
        short = name.rpartition(".")[2]
        if (DOCS / "images" / "plots" / f"{short}.webp").is_file() and "plot." in name:
            calls = tomllib.loads((DOCS / "images" / "plots.toml").read_text(encoding="utf-8"))
            lines += [".. rubric:: Picture", "", ".. code-block:: python", ""]
            lines += [f"   {calls['calls'][short]}", ""]
            lines += [f".. image:: /images/plots/{short}.webp"]
            lines += [f"   :alt: Picture drawn by {short}", ""]
        if users := figures_by_name().get(name):
            lines += [f".. rubric:: Figures that use {short}", "", ".. grid:: 2 2 4 4",
                      "   :gutter: 2", "   :class-container: gallery", ""]  # fmt: skip
            users = sorted(users, key=lambda figure: not _is_direct(figure, short))
            for figure in users[:MAX_FIGURES]:
                lines += [f"   .. grid-item-card:: {figure.label}",
                          f"      :link: /gallery/figures/{figure.script}",
                          "      :link-type: doc",
                          f"      :link-alt: {figure.shows}",
                          f"      :img-top: /gallery/thumbnails/{figure.script}.webp",
                          f"      :img-alt: {figure.title}", ""]  # fmt: skip
        if guides := guides_by_name().get(name):
            links = ", ".join(f":doc:`/{page}`" for page in guides[:MAX_GUIDES])
            lines += [f"Pages that use {short}: {links}.", ""]
        node = nodes.container()
        node.document = self.state.document
        self.state.nested_parse(StringList(lines, "api-examples"), self.content_offset, node)
        return [node]


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("api-examples", ApiExamples)
    app.connect("autodoc-process-docstring", add_see_also, priority=100)  # before numpydoc
    return {"parallel_read_safe": True, "parallel_write_safe": True}
