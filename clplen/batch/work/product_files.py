"""Files that an item writes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SUFFIXES = {"ome-tiff": ".ome.tif", "ome-zarr": ".ome.zarr"}


@dataclass(frozen=True)
class Product:
    """A file or folder to write: its name, and what writes it under that name."""

    name: str
    write: Callable[[Path], Any]


def in_formats(
    stem: str, formats: Iterable[str], write: Callable[..., Any], *values: Any, **more: Any
) -> list[Product]:
    """Return a product of each format; ``write`` takes path and values."""
    how = {"durable": True, "replace": True} | more

    def put(path: Path) -> None:
        write(path, *values, **how)

    return [Product(stem + SUFFIXES[name], put) for name in formats]
