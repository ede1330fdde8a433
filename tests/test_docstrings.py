"""Docstrings of public names: sections as numpydoc asks for them, and examples that run."""

from __future__ import annotations

import doctest
import inspect
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from public_names import bridge_names, public_objects

import clplen

OBJECTS = {
    f"clplen.{name}": value
    for name, value in (public_objects() | bridge_names()).items()
    if inspect.isclass(value) or inspect.isroutine(value)
}
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


def complaints(path: str, value: Any) -> list[str]:
    """What numpydoc finds wrong with a public name."""
    validate = pytest.importorskip("numpydoc.validate", reason="numpydoc: pip install '.[docs]'")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = validate.validate(path)["errors"]
        doc = validate.Validator(validate.get_doc_object(value))
    if getattr(value, "_is_protocol", False):  # made by nobody: its *args are Python's own
        found = [(code, text) for code, text in found if code != "PR01"]
    described = set(doc.doc_all_parameters) | {a.name for a in doc.doc["Attributes"]}
    told = {word.strip() for names in described for word in names.split(",")}
    missing = set(doc.signature_parameters) - told
    return [
        f"{code}: {text}"
        for code, text in found
        # fields of a result are its attributes
        if code in CHECKS and not (code == "PR01" and inspect.isclass(value) and not missing)
    ]


@pytest.mark.thorough
@pytest.mark.parametrize("path", OBJECTS)
def test_sections(path: str) -> None:
    assert complaints(path, OBJECTS[path]) == []


@pytest.mark.thorough
@pytest.mark.parametrize("path", OBJECTS)
def test_examples(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = {"np": np, "clplen": clplen}
    source = inspect.getdoc(OBJECTS[path]) or ""
    test = doctest.DocTestParser().get_doctest(source, dict(given), path, path, 0)
    assert test.examples, f"{path} has no example"
    said: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        failed = doctest.DocTestRunner(optionflags=FLAGS).run(test, out=said.append).failed
    assert failed == 0, "".join(said)
