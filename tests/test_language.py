"""The language of the package: what its docstrings begin with, and which names it does not use."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "clplen"

# A docstring begins with a verb in the imperative or a noun phrase; a parameter's description with
# a noun or an article.
FRAGMENTS = frozenset(
    {
        "what",
        "whether",
        "how",
        "of",
        "those",
        "which",
        "that",
        "where",
        "when",
        "by",
        "as",
        "with",
        "about",
        "from",
        "without",
        "same",
        "all",
        "one",
        "whose",
        "in",
        "to",
        "for",
        "at",
        "on",
        "if",
        "than",
    }
)
# Function words and participles, which name nothing.
BANNED_NAMES = frozenset(
    {
        "found",
        "made",
        "one",
        "place",
        "places",
        "said",
        "told",
        "kept",
        "held",
        "seen",
        "known",
        "words",
        "beside",
        "own",
        "wanted",
        "given",
        "taken",
        "least",
        "most",
        "fewest",
        "few",
        "many",
        "shown",
        "asked",
        "meant",
        "same",
        "here",
        "there",
        "still",
        "whole",
    }
)
# Parts of names that tell no reader what is named.
BANNED_PARTS = frozenset({"said", "told", "asked", "meant", "shown", "wanted"})
DESCRIBED = re.compile(r"[\w*, ]+ : \S")
MAX_PRIVATE_LINES = 3  # lines of a docstring of a private definition

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def first_word(text: str) -> str:
    """Return the first word of a text, without punctuation, in lower case."""
    return text.split()[0].strip(".,:;").lower()


def fragments(node: Definition, text: str) -> Iterator[str]:
    """Yield what is wrong with a docstring."""
    if first_word(text) in FRAGMENTS:
        yield f"docstring begins as a fragment: {text.splitlines()[0]}"
    lines = text.splitlines()
    for head, body in pairwise(lines):
        described = DESCRIBED.match(head) and body.startswith("    ") and body.split()
        if described and first_word(body) in FRAGMENTS:
            yield f"description begins as a fragment: {head}: {body.strip()}"
    is_private = node.name.startswith("_") and not node.name.endswith("__")
    if is_private and len(lines) > MAX_PRIVATE_LINES:
        yield f"private docstring has {len(lines)} lines, at most {MAX_PRIVATE_LINES}"


def names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield the line and the name of each assignment, argument and definition."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, Definition):
            yield node.lineno, node.name


def faults(source: str) -> Iterator[str]:
    """Yield a line for each breach of the rules in the source of a module."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, Definition) and (text := ast.get_docstring(node)):
            for fault in fragments(node, text):
                yield f"{node.lineno} {node.name}: {fault}"
    for line, name in names(tree):
        bare = name.lower().strip("_")
        if bare in BANNED_NAMES or BANNED_PARTS.intersection(bare.split("_")):
            yield f"{line} {name}: no noun of the field"


def test_language_of_the_package() -> None:
    """Each docstring begins as a sentence, and each name is a noun of the field."""
    breaches = [
        f"{path.relative_to(PACKAGE.parent)}:{fault}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for fault in faults(path.read_text(encoding="utf-8"))
    ]
    assert not breaches, "\n".join(breaches)


def test_faults_are_found() -> None:
    """Every rule finds its own breach."""
    source = '''
def propagate(x, said_of):
    """Whether light arrives.

    Parameters
    ----------
    x : int
        Of the field.
    """
    found = x

def _inner():
    """Return.

    Line.
    Line.
    """
'''
    assert len(list(faults(source))) == 5
