"""Tables of TOML files from the fields of settings models (`clplen.settings`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_type_hints

from pydantic import BeforeValidator, Field, create_model, model_validator

from clplen.config.settings import setting
from clplen.config.tables import Table
from clplen.settings.declaration import Setting, settings_of

Model = TypeVar("Model")


def table_of(name: str, module: str, doc: str, *models: type, **more: Any) -> Any:
    """Return the table of a module with the keys of some settings models, checked as they check.

    ``more`` are fields of its own, as of ``pydantic.create_model``, which come first.
    """

    def go_together(table: Table) -> Table:
        values = table.model_dump(include={key for key in fields if key not in more})
        for model in models:
            take_settings(model, values)
        return table

    fields = more | setting_fields(*models)
    validators: Any = {"_go_together": model_validator(mode="after")(go_together)}
    about: Any = {"__module__": module, "__doc__": doc, "__validators__": validators}
    return create_model(name, __base__=Table, **about, **fields)


def setting_fields(*models: type) -> dict[str, Any]:
    """Return the fields of a table with the keys of some models, for ``pydantic.create_model``."""
    found = {}
    for model in models:
        hints = get_type_hints(model)
        for one in settings_of(model):
            kind: Any = _kind(one, hints[one.name])
            checked = Annotated[kind, BeforeValidator(_checker(one))]
            field = setting(
                one.default, one.help, example=one.example, default_text=one.default_text
            )
            found[one.key] = (checked, field)
    return found


def _kind(one: Setting, hint: Any) -> Any:
    """Return the type of a key, with its choices and bounds for tables of the documentation."""
    if one.kind is Path:
        return str | None
    kind: Any = one.kind
    if one.kind is str and one.choices:
        kind = Literal.__getitem__(one.choices)
    elif one.kind in (int, float) and not (one.choices or one.pair or one.check):
        kind = Annotated[kind, Field(ge=one.minimum, gt=one.above)]
    else:
        return hint
    return kind if one.default is not None else kind | None


def _checker(one: Setting) -> Callable[[Any], Any]:
    return lambda value: one.read(value)


def take_settings(model: type[Model], table: dict[str, Any], folder: Path | None = None) -> Model:
    """Take the values of a model out of a table; names of files are seen from a folder."""
    values = {}
    for one in settings_of(model):
        value = one.in_metres(table.pop(one.key, one.default))
        if one.kind is Path and value is not None and folder is not None:
            value = Path(folder, value)
        values[one.name] = value
    return model(**values)
