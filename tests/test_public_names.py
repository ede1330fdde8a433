"""What is public: few names on top, the rest by topic, and every type that a public call
returns."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import types
import typing
from typing import Any

import pytest
from public_names import TOPICS, public_classes, public_functions, public_objects, topic_names

import clplen

# What has no counterpart, and why.
ONE_WAY = {
    "animation": "shown, not computed with",
    "colmap": "for other programs",
    "disparity": "of many formats and programs; write_depth and write_pfm write them",
    "focused": "read_image reads the picture; its geometry is that of the raw image",
    "focused_depth": "for other programs; its geometry is that of the raw image",
    "frame": "of many formats; write_picture writes one",
    "glb": "for other programs; write_ply keeps what read_ply reads",
    "html": "a page to look at; it holds pictures, not samples to compute with",
    "lattice": "of JSON and Raytrix XML; Lattice.save and write_raytrix write them",
    "nerf": "for other programs",
    "quilt": "a picture for a display; read_picture reads it",
    "mosaic": "read_lightfield reads it",
    "volume_series": "grows while clplen microscope deconvolve runs",
    "scene_truth": "all that write_truth writes; read_truth is of any data set",
    "views": "read_lightfield reads it",
    "zemax_opd": "listings of another program; write_opd_maps writes the maps",
}


def test_few_names_stand_on_top() -> None:
    assert 40 <= len(clplen.__all__) <= 50
    assert len(clplen.__all__) == len(set(clplen.__all__))


def test_every_name_is_there_and_has_a_docstring() -> None:
    for name, value in public_objects().items():
        if inspect.isclass(value) or inspect.isroutine(value):
            assert inspect.getdoc(value), f"{name} has no docstring"


def test_names_on_top_belong_to_a_topic() -> None:
    below = {id(value) for value in topic_names().values()}
    of_topics = {name for name in clplen.__all__ if id(getattr(clplen, name)) not in below}
    found = {name: getattr(clplen, name) for name in of_topics}
    errors = {n for n, one in found.items() if inspect.isclass(one) and issubclass(one, Exception)}
    # camera files and the viewer stand above every topic
    assert of_topics - errors == {"Device", "Image", "read_camera", "view"}


def test_no_name_means_two_things() -> None:
    names = [name.rpartition(".")[2] for name in topic_names() if not name.startswith("plot.")]
    values: dict[str, set[int]] = {}
    for name, value in topic_names().items():
        if not name.startswith("plot."):
            values.setdefault(name.rpartition(".")[2], set()).add(id(value))
    assert {name for name in names if len(values[name]) > 1} == set()


def classes_in(annotation: Any) -> set[type]:
    """The classes of the package in an annotation."""
    if isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is not None:
        return set().union(*(classes_in(part) for part in typing.get_args(annotation)))
    if isinstance(annotation, list):
        return set().union(*map(classes_in, annotation))
    inside = inspect.isclass(annotation) and annotation.__module__.split(".")[0] == "clplen"
    return {annotation} if inside else set()


def returned(value: Any) -> set[type]:
    """Classes of the package that a function returns."""
    try:
        hints = typing.get_type_hints(inspect.unwrap(value))
    except (TypeError, NameError):
        return set()
    return classes_in(hints.get("return"))


def members(kind: type) -> dict[str, Any]:
    """Public methods, class methods and properties of a class."""
    found = {}
    for name in dir(kind):
        if name.startswith("_"):
            continue
        value = inspect.getattr_static(kind, name)
        value = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
        if inspect.isfunction(value):
            found[name] = value
    return found


def test_every_type_that_a_public_call_returns_is_public() -> None:
    public = set(public_classes().values())
    missing = {}
    calls = dict(public_functions())
    for name, kind in public_classes().items():
        calls |= {f"{name}.{member}": value for member, value in members(kind).items()}
    for name, value in calls.items():
        hidden = {k for k in returned(value) - public if not is_protocol(k) and not is_low(k)}
        if hidden:
            missing[name] = sorted(k.__name__ for k in hidden)
    assert missing == {}


def is_low(kind: type) -> bool:
    """Whether a class belongs to the devices themselves, which are no topic."""
    return kind.__module__.startswith("clplen.compute.")


def is_protocol(kind: type) -> bool:
    """Whether a class only says what a thing must have."""
    return bool(getattr(kind, "_is_protocol", False))


def test_what_is_written_is_read() -> None:
    names = set(clplen.io.__all__)
    readers = {name[5:] for name in names if name.startswith("read_")}
    writers = {name[6:] for name in names if name.startswith("write_")}
    assert readers ^ writers == set(ONE_WAY)


def test_topics_are_attributes() -> None:
    for topic in TOPICS:
        assert isinstance(getattr(clplen, topic), types.ModuleType)
        names = getattr(clplen, topic).__all__
        assert len(names) == len(set(names))
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = clplen.no_such_name


def test_no_public_name_is_a_module_of_its_topic() -> None:
    # Importing such a module would put itself where the name was.
    for topic in (*TOPICS, "bench"):
        module = importlib.import_module(f"clplen.{topic}")
        inside = {info.name for info in pkgutil.iter_modules(module.__path__)}
        names = {n for n in module.__all__ if not inspect.ismodule(getattr(module, n))}
        assert not inside & names
