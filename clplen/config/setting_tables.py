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
    """Return a table class with the keys and checks of settings models.

    ``more`` are additional fields, as in ``pydantic.create_model``; they precede the others.
    """

    def check_models(table: Table) -> Table:
        values = table.model_dump(include={key for key in fields if key not in more})
        for model in models:
            take_settings(model, values)
        return table

    fields = more | setting_fields(*models)
    validators: Any = {"_go_together": model_validator(mode="after")(check_models)}
    about: Any = {"__module__": module, "__doc__": doc, "__validators__": validators}
    return create_model(name, __base__=Table, **about, **fields)


def setting_fields(*models: type) -> dict[str, Any]:
    """Return the fields of a table with the keys of some models, for ``pydantic.create_model``."""
    result = {}
    for model in models:
        hints = get_type_hints(model)
        for entry in settings_of(model):
            kind: Any = _kind(entry, hints[entry.name])
            checked = Annotated[kind, BeforeValidator(_checker(entry))]
            field = setting(
                entry.default, entry.help, example=entry.example, default_text=entry.default_text
            )
            result[entry.key] = (checked, field)
    return result


def _kind(entry: Setting, hint: Any) -> Any:
    """Return the type of a key, with its choices and bounds for tables of the documentation."""
    if entry.kind is Path:
        return str | None
    kind: Any = entry.kind
    if entry.kind is str and entry.choices:
        kind = Literal.__getitem__(entry.choices)
    elif entry.kind in (int, float) and not (entry.choices or entry.pair or entry.check):
        kind = Annotated[kind, Field(ge=entry.minimum, gt=entry.above)]
    else:
        return hint
    return kind if entry.default is not None else kind | None


def _checker(entry: Setting) -> Callable[[Any], Any]:
    return lambda value: entry.read(value)


def take_settings(model: type[Model], table: dict[str, Any], folder: Path | None = None) -> Model:
    """Remove the values of a model from a table; resolve file names against a folder."""
    values = {}
    for entry in settings_of(model):
        value = entry.in_metres(table.pop(entry.key, entry.default))
        if entry.kind is Path and value is not None and folder is not None:
            value = Path(folder, value)
        values[entry.name] = value
    return model(**values)
