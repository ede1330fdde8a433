"""The commands: a page each, by sphinx-click."""

from __future__ import annotations

from pathlib import Path

import click
from sphinx.application import Sphinx
from written import remove_others, write_page

from clplen.cli import main


def commands(group: click.Group, prefix: str = "clplen") -> dict[str, click.Command]:
    """Commands by the words that call them, those of groups too."""
    found: dict[str, click.Command] = {}
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        found[f"{prefix} {name}"] = command
        if isinstance(command, click.Group):
            found |= commands(command, f"{prefix} {name}")
    return found


def _attribute(words: str) -> str:
    return "_".join(words.split()[1:]).replace("-", "_")


def __getattr__(name: str) -> click.Command:
    """Commands as attributes of this module, which is how sphinx-click finds them."""
    found = {_attribute(words): command for words, command in commands(main).items()}
    try:
        return found[name]
    except KeyError:
        raise AttributeError(name) from None


def command_page(words: str) -> str:
    """The page of a command, in reStructuredText."""
    target = f"command_pages:{_attribute(words)}"
    lines = [f".. click:: {target}", f"   :prog: {words}"]
    return "\n".join([*lines, "   :nested: none", ""])


def write_pages(app: Sphinx, _config: object) -> None:
    """Write the page of every command."""
    folder = Path(app.srcdir, "reference", "commands")
    pages = {folder / f"{_attribute(words)}.rst": words for words in commands(main)}
    for path, words in pages.items():
        write_page(path, command_page(words))
    remove_others(folder, {*pages, folder / "index.md"})


def show_examples_as_code(app: Sphinx, ctx: click.Context, lines: list[str]) -> None:
    """Turn the indented lines of a block of help, its commands, into a code block."""
    text: list[str] = []
    for line in lines:
        is_command = line.startswith("|  ")
        if is_command and not (text and text[-1].startswith("   ")):
            text += ["", ".. code-block:: sh", ""]
        elif not is_command and text and text[-1].startswith("   "):
            text.append("")
        text.append("   " + line[1:].strip() if is_command else line)
    lines[:] = text


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("config-inited", write_pages)
    app.connect("sphinx-click-process-description", show_examples_as_code)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
