"""Warnings that point to the caller's line, and second keywords of arguments."""

from __future__ import annotations

import warnings
from inspect import signature
from pathlib import Path

import pytest

from clplen.checks import alias_argument
from clplen.errors import warn_caller


@alias_argument(f="focal_length")
def power(focal_length: float, *, index: float = 1.0) -> float:
    return index / focal_length


def test_an_alias_is_the_argument() -> None:
    assert power(f=2.0) == power(2.0) == power(focal_length=2.0) == 0.5
    assert list(signature(power).parameters) == ["focal_length", "index"]
    for arguments, keywords in (((2.0,), {"f": 2.0}), ((), {"f": 2.0, "focal_length": 2.0})):
        with pytest.raises(TypeError, match="focal_length"):
            power(*arguments, **keywords)


def test_frames_of_the_package_are_passed_over() -> None:
    inside = {"__name__": "clplen.somewhere", "warn_caller": warn_caller}
    exec("def warn(): warn_caller('low light', UserWarning)", inside)
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always")
        inside["warn"]()
    assert [Path(warning.filename) for warning in issued] == [Path(__file__)]
