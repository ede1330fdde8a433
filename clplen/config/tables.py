"""What the tables of a camera file are made of: numbers within limits, pairs, names of files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo

from clplen.errors import ClplenError, FormatError

# Strict: "120", true and 101.5 are no whole numbers here.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Count = Annotated[int, Field(ge=1, strict=True)]
Seed = Annotated[int, Field(ge=0, lt=2**64, strict=True)]
Switch = Annotated[bool, Field(strict=True)]


def twice(value: Any) -> Any:
    """One number for rows and columns."""
    return value if isinstance(value, list) else [value, value]


def listed(value: Any) -> Any:
    """One number where there may be several."""
    return value if isinstance(value, list) else [value]


def of(count: int, words: str) -> BeforeValidator:
    """Refuse, in these words, what is no list of so many values."""

    def check(value: Any) -> Any:
        if not isinstance(value, list) or len(value) != count:
            raise ValueError(f"must be {words}")
        return value

    return BeforeValidator(check)


def _there(value: Any, info: ValidationInfo) -> Path:
    """The path of a file that is there; names are seen from the folder of the camera file."""
    if not isinstance(value, str):
        raise ValueError("must be the name of a file")
    path = Path((info.context or {}).get("folder", "."), value)
    if not path.is_file():
        raise ValueError(f"must name a file, and there is none at {path}")
    return path


File = Annotated[Path, BeforeValidator(_there)]


class Table(BaseModel):
    """A table of the file; keys that it does not know are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@contextmanager
def value_of(key: str) -> Iterator[None]:
    """Put the key before what is said about its value."""
    try:
        yield
    except (ValueError, ClplenError) as error:
        raise FormatError(f"{key}: {error}") from error


def divided(value: float | None, by: float) -> float | None:
    """In SI units: 200 / 1e6 is 0.0002, while 200 * 1e-6 is 0.00019999999999999998."""
    return None if value is None else value / by
