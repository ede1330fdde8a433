"""Old names of arguments and attributes."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from inspect import signature
from pathlib import Path

import pytest

from clplen.deprecation import renamed_argument, renamed_attribute, warn_caller


@renamed_argument(old="f", new="focal_length")
def power(focal_length: float, *, index: float = 1.0) -> float:
    return index / focal_length


@renamed_argument(old="f", new="focal_length", warn=False)
@dataclass(frozen=True)
class Mirror:
    focal_length: float
    f = renamed_attribute("f", "focal_length", warn=False)


def test_the_old_keyword_warns_from_the_callers_line() -> None:
    with pytest.warns(DeprecationWarning, match=r"power\(\) takes focal_length=; its old") as said:
        assert power(f=2.0) == 0.5
    assert Path(said[0].filename) == Path(__file__)


def test_the_new_keyword_and_positions_do_not_warn() -> None:
    assert power(focal_length=2.0) == power(2.0) == 0.5
    assert list(signature(power).parameters) == ["focal_length", "index"]


def test_old_and_new_together_are_refused() -> None:
    with pytest.raises(TypeError, match="focal_length twice"):
        power(2.0, f=2.0)
    with pytest.raises(TypeError, match="focal_length twice"):
        power(focal_length=2.0, f=2.0)


def test_a_class_takes_the_old_keyword_and_has_the_old_attribute() -> None:
    assert Mirror(f=3.0) == Mirror(3.0) == Mirror(focal_length=3.0)
    assert Mirror(3.0).f == 3.0
    with pytest.raises(TypeError, match="twice"):
        Mirror(3.0, f=2.0)


def test_a_deprecated_attribute_warns_from_the_callers_line() -> None:
    class Lamp:
        power = 5.0
        watts = renamed_attribute("watts", "power")

    with pytest.warns(DeprecationWarning, match="Lamp.watts is deprecated") as said:
        assert Lamp().watts == 5.0
    assert Path(said[0].filename) == Path(__file__)


def test_frames_of_the_package_are_passed_over() -> None:
    inside = {"__name__": "clplen.somewhere", "warn_caller": warn_caller}
    exec("def warn(): warn_caller('low light', UserWarning)", inside)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        inside["warn"]()
    assert [Path(one.filename) for one in said] == [Path(__file__)]
