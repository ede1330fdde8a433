"""Links of public names in text: `clplen.refocus`, `LightField.from_raw`, `focal_stack`."""

from __future__ import annotations

import collections
import functools
import importlib
import inspect
import re

from api_pages import unique_names
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.nodes import make_refnode

_NAME = re.compile(r"~?((?:[A-Za-z_]\w*\.)*[A-Za-z_]\w*)(?:\(.*\))?")

_CLASS = re.compile(r"\b([A-Z]\w+)\b")


@functools.cache
def parameter_names() -> set[str]:
    """Return the names of parameters of public functions, which text names too."""
    names: set[str] = set()
    for paths in unique_names().values():
        for path in paths:
            module, _, name = path.rpartition(".")
            value = getattr(importlib.import_module(module), name)
            if callable(value):
                try:
                    names |= set(inspect.signature(value).parameters)
                except (TypeError, ValueError):
                    continue
    return names


class NameLinks(SphinxPostTransform):
    """Turn literals that name one public object into links."""

    default_priority = 700
    formats = ("html",)

    def run(self, **kwargs: object) -> None:
        targets = self._targets()
        for node in list(self.document.findall(nodes.literal)):
            match = _NAME.fullmatch(node.astext())
            target = targets.get(match[1]) if match else None
            if target is None or self._is_linked(node) or target[1] == self.env.docname:
                continue
            full, page, anchor = target
            text = node.deepcopy()
            link = make_refnode(self.app.builder, self.env.docname, page, anchor, text, full)
            node.replace_self(link)

        for node in list(self.document.findall(nodes.classifier)):
            parts = [self._class_link(part, targets) for part in _CLASS.split(node.astext())]
            node.clear()
            node.extend(parts)
        for node in list(self.document.findall(nodes.term)):  # in Returns and Raises
            if node.astext() in targets:
                link = self._class_link(node.astext(), targets)
                node.clear()
                node.append(link)

    def _class_link(self, word: str, targets: dict[str, tuple[str, str, str]]) -> nodes.Node:
        """Return a link to the class of this name, or the text."""
        target = targets.get(word) if word[:1].isupper() else None
        if target is None or target[1] == self.env.docname:
            return nodes.Text(word)
        full, page, anchor = target
        text = nodes.inline(word, word)
        return make_refnode(self.app.builder, self.env.docname, page, anchor, text, full)

    def _is_linked(self, node: nodes.Node) -> bool:
        """Return True inside links, titles and signatures."""
        if not isinstance(node.parent, nodes.TextElement):
            return True
        while (node := node.parent) is not None:
            if isinstance(node, nodes.reference | nodes.title | nodes.rubric):
                return True
            if node.tagname.startswith("desc_signature"):
                return True
        return False

    def _targets(self) -> dict[str, tuple[str, str, str]]:
        """Return full name, page and anchor of each name that is unambiguous in text."""
        cached = getattr(self.env, "name_link_targets", None)
        if cached is not None:
            return cached
        entries = {full: (full, entry.docname, entry.node_id)
                   for full, entry in self.env.domains["py"].objects.items()}  # fmt: skip
        short = collections.defaultdict(list)
        for full in entries:
            parts = full.split(".")
            for count in (1, 2):
                short[".".join(parts[-count:])].append(full)
        targets = dict(entries)
        for name, fulls in short.items():
            on_top = [full for full in fulls if full == f"clplen.{name}"]
            is_word = "." not in name and name.islower() and "_" not in name
            if name in parameter_names() or (is_word and not on_top):
                continue
            if on_top or len(fulls) == 1:
                targets[name] = entries[(on_top or fulls)[0]]
        self.env.name_link_targets = targets
        return targets


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_post_transform(NameLinks)
    app.connect("env-updated", lambda _app, env: setattr(env, "name_link_targets", None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
