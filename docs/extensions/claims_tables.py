"""The directive ``claims``: published figures as benchmarks/claims.toml holds them.

``{claims} steps`` gives the rows of a group: quantity, figures, date and machine, and how they are
measured again.
"""

from __future__ import annotations

import sys
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parents[2]))

from benchmarks.claims import claims


def table_of(group: str) -> list[str]:
    """Return the lines of a table in Markdown; raise KeyError if there is no such group."""
    rows = [claim for claim in claims() if claim.group == group]
    if not rows:
        raise KeyError(f"benchmarks/claims.toml has no group {group}.")
    lines = ["| quantity | figures | measured on | by |", "|---|---|---|---|"]
    for claim in rows:
        how = f"`{claim.test}`" if claim.test else f"`{claim.command}`"
        where = f"{claim.date}, {claim.machine}"
        lines.append(f"| {claim.says} | {claim.figures or 'a limit'} | {where} | {how} |")
    return lines


class Claims(Directive):
    """A table of a group of claims."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        node = nodes.container()
        node.document = self.state.document
        lines = StringList(table_of(self.arguments[0]), "claims")
        self.state.nested_parse(lines, self.content_offset, node)
        return node.children


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("claims", Claims)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
