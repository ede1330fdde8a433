"""Tables of TOML files: types of values, reading and validation messages."""

from __future__ import annotations

import difflib
import math
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo

from clplen.errors import ClplenError, FormatError, arguments_as
from clplen.reprs import one_line
from clplen.settings.declaration import SettingError, format_value

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Model = TypeVar("Model", bound=BaseModel)
# Conditions in the terms of TOML, by pydantic's names of errors.
_EXPECTED = {
    "model_type": "must be a table",
    "dict_type": "must be a table",
    "bool_type": "must be true or false",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "string_type": "must be a text",
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "greater_than": "must be above {gt:g}",
    "greater_than_equal": "must be {ge:g} or more",
    "less_than": "must be below {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "too_short": "must have {min_length} or more values",
    "too_long": "must have {max_length} or fewer values",
}

MAX_TOML_BYTES = 1 << 24  # 16 MiB; a job with 100 000 file names has 10
MAX_KEY_PARTS = 32  # parts of a dotted key; the time of tomllib grows with their square
_TOKEN = re.compile(  # the end of a string is optional, so that matching takes linear time
    r"""\"{3}(?:\\.|[^\\])*?(?:\"{3}|\Z)|'{3}.*?(?:'{3}|\Z)"""  # strings of several lines
    r"""|(?P<part>"(?:\\.|[^"\\\n])*"?|'[^'\n]*'?|[\w-]+)|(?P<dot>\.)|(?P<blank>[ \t]+)"""
    r"""|\#[^\n]*|.""",
    re.DOTALL,
)


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Read the content of a TOML file; ``what`` names the file in messages."""
    if not path.is_file():
        raise FormatError(f"There is no {what}.")
    if path.stat().st_size > MAX_TOML_BYTES:
        raise FormatError(
            f"{path} must be a TOML file of at most {MAX_TOML_BYTES:,} bytes: check its name."
        )
    try:
        text = path.read_text(encoding="utf-8-sig")
        _require_short_keys(text, path)
        return tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not a text file: give a TOML file.") from error
    except RecursionError as error:
        raise FormatError(f"{path} nests arrays or tables too deeply: flatten them.") from error
    except ValueError as error:  # invalid TOML, or integers with more digits than Python reads
        raise FormatError(f"{path} is not TOML: {str(error).rstrip('.')}.") from error


def _require_short_keys(text: str, path: Path) -> None:
    """Raise an error for a dotted key with too many parts to be read in reasonable time."""
    if all(line.count(".") < MAX_KEY_PARTS for line in text.split("\n")):
        return
    dots = 0
    for token in _TOKEN.finditer(text):
        dots = {"dot": dots + 1, "part": dots, "blank": dots}.get(token.lastgroup or "", 0)
        if dots >= MAX_KEY_PARTS:
            number = text.count("\n", 0, token.start()) + 1
            raise FormatError(
                f"{path} has a key of more than {MAX_KEY_PARTS} parts in line {number}: flatten it."
            )


def validated(model: type[Model], content: dict[str, Any], path: Path) -> Model:
    """Validate the content of a file; resolve file names in it against its folder."""
    try:
        with arguments_as("file"):
            return model.model_validate(content, context={"folder": path.parent})
    except ValidationError as error:
        problems = problems_of(model, error)
        raise FormatError(f"{path}: {problems}{'' if problems.endswith('?') else '.'}") from error


def problems_of(model: type[BaseModel], error: ValidationError) -> str:
    """Return the errors of a validation as text."""
    return "; ".join(dict.fromkeys(_problem(model, entry) for entry in error.errors()))


def _problem(model: type[BaseModel], error: Any) -> str:
    """Return an error of pydantic as text."""
    path = [str(part) for part in error["loc"]]
    key = ".".join(path)
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["type"] != "extra_forbidden":
        return _wrong_value(error)
    valid = list(_table_at(model, path[:-1]).model_fields)
    near = difflib.get_close_matches(path[-1], valid, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"the keys are {', '.join(valid)}"
    return f"unknown key {key}; {hint}"


def _table_at(model: type[BaseModel], path: list[str]) -> type[BaseModel]:
    """Return the model of a nested table."""
    for name in path:
        if name in model.model_fields:
            model = model_in(model.model_fields[name].annotation) or model
    return model


def model_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model in an annotation such as ``list[Table] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for part in get_args(annotation) if (model := model_in(part))), None)


def _wrong_value(error: Any) -> str:
    """Describe a wrong value, or conflicting values of a table."""
    context = error.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, SettingError):
        return f"{_key(error)}.{cause.key} {cause.condition}".lstrip(".")
    if error["type"] == "greater_than" and context["gt"] == 0:
        condition = "must be a positive number"
    elif error["type"] in _EXPECTED:
        condition = _EXPECTED[error["type"]].format(**context)
    else:
        condition = error["msg"].removeprefix("Value error, ").replace("Input should", "must", 1)
    sentence = f"{_key(error)} {condition[0].lower()}{condition[1:]}".lstrip()
    is_table = error["type"] == "value_error" and isinstance(error["input"], dict)
    if is_table:
        return sentence
    got = f"got {format_value(error['input'])}"
    return f"{sentence} ({got})" if sentence.endswith("?") else f"{sentence}, {got}"


def _key(error: Any) -> str:
    """Return the key of an error, without the index in a pair of numbers."""
    path = list(error["loc"])
    if path and isinstance(path[-1], int) and error["type"] != "value_error":
        path.pop()
    return ".".join(map(str, path))


# Strict types: "120", true and 101.5 are not accepted as whole numbers.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Count = Annotated[int, Field(ge=1, lt=2**31, strict=True)]
Seed = Annotated[int, Field(ge=0, lt=2**64, strict=True)]
Switch = Annotated[bool, Field(strict=True)]


def twice(value: Any) -> Any:
    """Repeat a single number for rows and columns."""
    return value if isinstance(value, list) else [value, value]


def listed(value: Any) -> Any:
    """Wrap a single value in a list."""
    return value if isinstance(value, list) else [value]


def of(count: int, condition: str) -> BeforeValidator:
    """Return a validator that requires a list of ``count`` values."""

    def check(value: Any) -> Any:
        if not isinstance(value, list) or len(value) != count:
            raise ValueError(f"must be {condition}")
        return value

    return BeforeValidator(check)


def _existing_file(value: Any, info: ValidationInfo) -> Path:
    """Return the path of an existing file, resolved against the folder of the camera file."""
    if not isinstance(value, str):
        raise ValueError("must be the name of a file")
    path = Path((info.context or {}).get("folder", "."), value)
    try:
        exists = path.is_file()
    except (OSError, ValueError):  # raised for invalid file names
        exists = False
    if not exists:
        raise ValueError(f"must be an existing file, but {path} does not exist")
    return path


File = Annotated[Path, BeforeValidator(_existing_file)]


# Divisors of the units of keys. Division rounds correctly: 200 / 1e6 is 0.0002, while 200 * 1e-6 is
# 0.00019999999999999998.
_SI = {"nm": 1e9, "um": 1e6, "mm": 1e3, "m": 1.0, "mrad": 1e3, "deg": None}
_SI |= {"electrons": 1.0, "s": 1.0}


def _scaled(value: Any, unit: str) -> Any:
    """Convert a number, or a list or tuple of numbers, to SI units; None stays None."""
    if isinstance(value, list | tuple):
        return type(value)(_scaled(number, unit) for number in value)
    if value is None:
        return None
    by = _SI[unit]
    return math.radians(value) if by is None else value / by


class Table(BaseModel):
    """Table of a TOML file; unknown keys are rejected."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def in_si(self, *left_out: str) -> dict[str, Any]:
        """Return the values in SI units, by names without units; nested tables stay as they are."""
        values = {}
        for name in type(self).model_fields:
            stem, _, unit = name.rpartition("_")
            is_length = bool(stem) and unit in _SI
            if name not in left_out:
                value = getattr(self, name)
                values[stem if is_length else name] = _scaled(value, unit) if is_length else value
        return values

    def __repr__(self) -> str:
        names = [name for name in type(self).model_fields if name in self.model_fields_set]
        return one_line(self, {name: getattr(self, name) for name in names})


@contextmanager
def value_of(key: str) -> Iterator[None]:
    """Prepend a key to error messages about its value."""
    try:
        yield
    except (ValueError, ClplenError) as error:
        raise FormatError(f"{key}: {error}") from error
