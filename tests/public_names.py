"""Every public name: those on top and those of the topics one step down."""

from __future__ import annotations

import importlib.util
import inspect
from typing import Any

import clplen

TOPICS = ("analysis", "batch", "cameras", "io", "lightfield", "microscopy", "plot", "wave")


def topic_names() -> dict[str, Any]:
    """From ``topic.name`` to the object."""
    found = {}
    for topic in TOPICS:
        module = importlib.import_module(f"clplen.{topic}")
        found |= {f"{topic}.{name}": getattr(module, name) for name in module.__all__}
    return found


def bridge_names() -> dict[str, Any]:
    """From ``torch.name`` to the object, of topics whose library is installed."""
    found = {}
    for topic in filter(importlib.util.find_spec, clplen.BRIDGES):
        module = importlib.import_module(f"clplen.{topic}")
        found |= {f"{topic}.{name}": getattr(module, name) for name in module.__all__}
    return found


def public_objects() -> dict[str, Any]:
    """Every public object once, by its shortest name: ``LightField``, ``cameras.Aberrations``."""
    found = {name: getattr(clplen, name) for name in clplen.__all__}
    known = {id(value) for value in found.values()}
    return found | {name: value for name, value in topic_names().items() if id(value) not in known}


def public_classes() -> dict[str, type]:
    """The public classes among them."""
    return {name: value for name, value in public_objects().items() if inspect.isclass(value)}


def public_functions() -> dict[str, Any]:
    """The public functions among them."""
    found = public_objects().items()
    return {name: value for name, value in found if inspect.isroutine(value)}
