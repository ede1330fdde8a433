"""The directive ``toml-tables``: keys of a file as its pydantic model knows them.

``{toml-tables} clplen.config.camera_file:CameraFile`` gives a table of keys for the file and each
table in it: key, values that are taken, default, and the sentence of `clplen.config.settings`.
"""

from __future__ import annotations

import importlib
import json
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.nodes import nested_parse_with_titles

_BOUNDS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
_WORDS = {"number": "number", "integer": "whole number", "boolean": "true or false",
          "string": "text", "array": "list", "object": "table"}  # fmt: skip


def _resolved(schema: dict[str, Any], definitions: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The name of the table that a key holds, if it holds one, and its schema."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return name, definitions[name]
    return "", schema


def _number(value: float) -> str:
    return "2^64" if value == 2**64 else f"{value:g}"


def values_of(schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    """What a key takes, in words."""
    choices = [one for one in schema.get("anyOf", ()) if one.get("type") != "null"]
    if choices:
        return " or ".join(dict.fromkeys(values_of(one, definitions) for one in choices))
    name, schema = _resolved(schema, definitions)
    if name:
        return "table"
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return ", ".join(f"`{json.dumps(one)}`" for one in schema["enum"])
    kind = schema.get("type")
    if kind == "array":
        items = schema.get("items") or next(iter(schema.get("prefixItems", ())), {})
        count = schema.get("maxItems")
        inner = values_of(items, definitions) if items else "any"
        return f"list of {f'{count}: ' if count else ''}{inner}"
    bounds = [
        f"{sign} {_number(schema[key])}" for key, sign in _BOUNDS.items() if key in schema
    ]
    return " ".join([_WORDS.get(kind, "any value"), *bounds])


def _tables_in(schema: dict[str, Any], definitions: dict[str, Any]) -> list[tuple[str, bool]]:
    """Names of the tables that a key holds, and whether it is an array of tables."""
    options = schema.get("anyOf", [schema])
    items = [one["items"] for one in options if one.get("type") == "array" and "items" in one]
    found = [(one, False) for one in options] + [(one, True) for one in items]
    names = [(one["$ref"].rpartition("/")[2], many) for one, many in found if "$ref" in one]
    return [(name, many) for name, many in names if "properties" in definitions[name]]


def tables_of(schema: dict[str, Any]) -> list[tuple[str, list[list[str]]]]:
    """Each table of a file by its TOML header, with rows of key, values and default."""
    definitions = schema.get("$defs", {})
    found: list[tuple[str, list[list[str]]]] = []

    def walk(table: dict[str, Any], path: str, header: str) -> None:
        rows: list[list[str]] = []
        found.append((header, rows))
        required = table.get("required", ())
        for key, one in table.get("properties", {}).items():
            inner, here = _tables_in(one, definitions), f"{path}.{key}".lstrip(".")
            values, default = values_of(one, definitions), one.get("default")
            said = one.get("default_text") or "left out"
            if default is not None and not inner:
                said = f"`{json.dumps(default)}`"
            if inner:
                values = "array of tables, below" if inner[0][1] else "table, below"
            words = one.get("description", "").replace("|", "\\|")
            rows.append([f"`{key}`", values, "required" if key in required else said, words])
            for name, many in inner:
                walk(definitions[name], here, f"[[{here}]]" if many else f"[{here}]")

    walk(schema, "", "")
    return found


class TomlTables(Directive):
    """Tables of keys of a model."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        module, _, name = self.arguments[0].partition(":")
        model = getattr(importlib.import_module(module), name)
        lines: list[str] = []
        for path, rows in tables_of(model.model_json_schema()):
            lines += [f"### `{path}`" if path else "### Top level", ""]
            columns = 4 if any(row[3] for row in rows) else 3
            heading = ["key", "takes", "default", "meaning"][:columns]
            for row in (heading, ["---"] * columns, *rows):
                lines.append("| " + " | ".join(row[:columns]) + " |")
            lines.append("")
        node = nodes.section()
        node.document = self.state.document
        nested_parse_with_titles(self.state, StringList(lines, "toml-tables"), node)
        return node.children


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("toml-tables", TomlTables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
