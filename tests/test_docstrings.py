"""Docstrings of public names: sections as numpydoc asks for them, and examples that run."""

from __future__ import annotations

import doctest
import inspect
import warnings
from pathlib import Path
from typing import Any

import pytest

# numpydoc's checks that are on. Off are those of taste: an extended summary (ES01), a section See
# Also (SA01), and capitals for descriptions (PR08, RT04), which may begin with a symbol or a dtype.
CHECKS = (
    "EX01",  # an example
    "GL01", "GL02", "GL03", "GL05", "GL06", "GL07", "GL08", "GL09", "GL10",  # layout
    "PR01", "PR02", "PR03", "PR04", "PR05", "PR06", "PR07", "PR09", "PR10",  # parameters
    "RT01", "RT03", "RT05",  # what is returned
    "YD01",
    "SS01", "SS02", "SS03", "SS04", "SS05", "SS06",  # the summary
    "SA02", "SA03", "SA04",
)  # fmt: skip
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE

pytestmark = pytest.mark.thorough


def documented() -> dict[str, Any]:
    """Public classes and functions by their full names."""
    from public_names import bridge_names, public_objects

    return {
        f"clplen.{name}": value
        for name, value in (public_objects() | bridge_names()).items()
        if inspect.isclass(value) or inspect.isroutine(value)
    }


def complaints(validate: Any, path: str, value: Any) -> list[str]:
    """Errors that numpydoc finds in the docstring of a public name."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        errors = validate.validate(path)["errors"]
        doc = validate.Validator(validate.get_doc_object(value))
    if getattr(value, "_is_protocol", False):  # made by nobody: its *args are Python's own
        errors = [(code, text) for code, text in errors if code != "PR01"]
    described = set(doc.doc_all_parameters) | {a.name for a in doc.doc["Attributes"]}
    names = {word.strip() for line in described for word in line.split(",")}
    missing = set(doc.signature_parameters) - names
    return [
        f"{path}: {code}: {text}"
        for code, text in errors
        # fields of a result are its attributes
        if code in CHECKS and not (code == "PR01" and inspect.isclass(value) and not missing)
    ]


def test_sections() -> None:
    validate = pytest.importorskip("numpydoc.validate", reason="numpydoc: pip install '.[docs]'")
    objects = documented().items()
    assert [line for path, value in objects for line in complaints(validate, path, value)] == []


def test_examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy as np

    import clplen

    failures: list[str] = []
    for path, value in documented().items():
        folder = tmp_path / path
        folder.mkdir()
        monkeypatch.chdir(folder)
        source = inspect.getdoc(value) or ""
        names = {"np": np, "clplen": clplen}
        example = doctest.DocTestParser().get_doctest(source, names, path, path, 0)
        if not example.examples:
            failures.append(f"{path} has no example")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            doctest.DocTestRunner(optionflags=FLAGS).run(example, out=failures.append)
    assert not failures, "".join(failures)
