"""Output files of an item."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SUFFIXES = {"ome-tiff": ".ome.tif", "ome-zarr": ".ome.zarr"}


@dataclass(frozen=True)
class Product:
    """Output file or folder: its name, and a function that writes it to a path."""

    name: str
    write: Callable[[Path], Any]


def in_formats(
    stem: str, formats: Iterable[str], write: Callable[..., Any], *values: Any, **more: Any
) -> list[Product]:
    """Return a product for each format; ``write`` accepts a path and the values."""
    arguments = {"durable": True, "replace": True} | more

    def write_to(path: Path) -> None:
        write(path, *values, **arguments)

    return [Product(stem + SUFFIXES[name], write_to) for name in formats]
