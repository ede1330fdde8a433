"""The API reference: a page a topic, with a table of names from which autosummary makes theirs."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import textwrap
import types
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from written import remove_others, write_page

import clplen


def unique_names() -> dict[str, list[str]]:
    """The public names of each topic; a name on top is not repeated below."""
    names = {"clplen": [f"clplen.{name}" for name in clplen.__all__]}
    known = {id(getattr(clplen, name)) for name in clplen.__all__}
    for topic in (*clplen.TOPICS, *filter(importlib.util.find_spec, clplen.BRIDGES)):
        module = importlib.import_module(f"clplen.{topic}")
        found = {name: getattr(module, name) for name in module.__all__}
        names[f"clplen.{topic}"] = [
            f"clplen.{topic}.{name}" for name, value in found.items() if id(value) not in known
        ]
    return names


def _object(path: str) -> Any:
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def _table(title: str, paths: list[str]) -> list[str]:
    if not paths:
        return []
    lines = [title, "-" * len(title), "", ".. autosummary::", "   :toctree: generated", ""]
    return [*lines, *(f"   {path}" for path in sorted(paths)), ""]


def _constants(values: dict[str, Any]) -> list[str]:
    """Entries of constants and aliases of types, with their values."""
    if not values:
        return []
    lines = ["Constants and types", "-------------------", ""]
    for path, value in values.items():
        text = textwrap.shorten(repr(value), 200)
        lines += [f".. py:data:: {path}", "", f"   ``{text}``", ""]
    return lines


def topic_page(module: str, paths: list[str]) -> str:
    """The page of a topic, in reStructuredText."""
    summary = (inspect.getdoc(importlib.import_module(module)) or "").splitlines()[0]
    values = {path: _object(path) for path in paths}
    classes = [path for path, value in values.items() if _is_class(value)]
    functions = [path for path, value in values.items() if inspect.isroutine(value)]
    modules = [path for path, value in values.items() if inspect.ismodule(value)]
    constants = sorted(set(paths) - set(classes) - set(functions) - set(modules))
    title = f"``{module}``"
    lines = [title, "=" * len(title), "", summary, ""]
    lines += _table("Functions", functions)
    lines += _table("Classes", [path for path in classes if not _is_error(values[path])])
    lines += _table("Errors and warnings", [path for path in classes if _is_error(values[path])])
    for path in modules:
        about = (inspect.getdoc(values[path]) or "").splitlines()[0]
        lines += [f"``{path}``: {about}", ""]
    lines += _constants({path: values[path] for path in constants})
    return "\n".join(lines)


def absent_page(topic: str) -> str:
    """The page of a topic whose library is not installed, from its files."""
    folder = Path(clplen.__file__).parent / topic
    about = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
    tree = ast.parse((folder / "__init__.pyi").read_text())
    names = [a.name for n in tree.body if isinstance(n, ast.ImportFrom) for a in n.names]
    title = f"``clplen.{topic}``"
    words = ", ".join(f"``{name}``" for name in sorted(names))
    lines = [title, "=" * len(title), "", about.partition("\n")[0], ""]
    lines += [f"This site was built without {topic}. ``help()`` of Python shows {words}.", ""]
    return "\n".join(lines)


def _is_class(value: Any) -> bool:
    return inspect.isclass(value) and not isinstance(value, types.GenericAlias)


def _is_error(value: type) -> bool:
    return issubclass(value, BaseException)


def write_pages(app: Sphinx, _config: object) -> None:
    """Write the page of every topic."""
    folder = Path(app.srcdir, "reference", "api")
    names = unique_names()
    for module, paths in names.items():
        write_page(folder / f"{module}.rst", topic_page(module, paths))
    for topic in clplen.BRIDGES:
        if f"clplen.{topic}" not in names:
            write_page(folder / f"clplen.{topic}.rst", absent_page(topic))
    known = {folder / "generated" / f"{path}.rst" for paths in names.values() for path in paths}
    remove_others(folder / "generated", known)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("config-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
