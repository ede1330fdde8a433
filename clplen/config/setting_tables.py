"""Tables of TOML files from the fields of settings models (`clplen.settings`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import BeforeValidator

from clplen.config.settings import setting
from clplen.settings import Setting, SettingError, settings_of

Model = TypeVar("Model")


def setting_fields(*models: type) -> dict[str, Any]:
    """Return the fields of a table with the keys of some models, for ``pydantic.create_model``."""
    found = {}
    for model in models:
        hints = get_type_hints(model)
        for one in settings_of(model):
            kind: Any = str | None if one.kind is Path else hints[one.name]
            checked = Annotated[kind, BeforeValidator(_checker(one))]
            field = setting(
                one.default, one.help, example=one.example, default_text=one.default_text,
                metavar=one.metavar or "",
            )  # fmt: skip
            found[one.key] = (checked, field)
    return found


def _checker(one: Setting) -> Callable[[Any], Any]:
    def check(value: Any) -> Any:
        if not one.fits(value):
            raise ValueError(one.rule)
        return value

    return check


def take_settings(model: type[Model], table: dict[str, Any], folder: Path | None = None) -> Model:
    """Take the values of a model out of a table; names of files are seen from a folder."""
    values = {}
    for one in settings_of(model):
        value = one.in_python(table.pop(one.key, one.default))
        if one.kind is Path and value is not None and folder is not None:
            value = Path(folder, value)
        values[one.name] = value
    try:
        return model(**values)
    except SettingError as error:
        key = next(one.key for one in settings_of(model) if one.name == error.argument)
        raise ValueError(f"{key} {error.condition}") from error
