"""`clplen.torch` and `clplen.jax`: found when asked for; what they say without their library."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

import clplen

PACKAGE = Path(clplen.__file__).parent
LIBRARIES = {"jax": "JAX", "torch": "PyTorch"}


def test_bridges_are_those_of_the_package() -> None:
    assert set(clplen.BRIDGES) == set(LIBRARIES)
    assert not set(clplen.BRIDGES) & set(clplen.__all__)


@pytest.mark.parametrize("topic", LIBRARIES)
def test_without_the_library_one_sentence_names_the_extra(
    topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, topic, None)  # as if it were not installed
    for name in [name for name in sys.modules if name.startswith(f"clplen.{topic}")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(vars(clplen), topic, raising=False)
    said = (
        f"clplen.{topic} needs {LIBRARIES[topic]}, which is not installed: "
        f'pip install "clplen[{topic}]".'
    )
    with pytest.raises(ModuleNotFoundError) as error:
        importlib.import_module(f"clplen.{topic}")
    assert str(error.value) == said
    with pytest.raises(ModuleNotFoundError) as error:
        getattr(clplen, topic)
    assert str(error.value) == said


@pytest.mark.parametrize("topic", LIBRARIES)
def test_a_bridge_is_an_attribute_with_the_names_of_its_stub(topic: str) -> None:
    pytest.importorskip(topic, reason=f'{LIBRARIES[topic]}: pip install "clplen[{topic}]"')
    bridge = getattr(clplen, topic)
    assert sorted(bridge.__all__) == ["apply", "apply_step", "propagate"]
    assert all(callable(getattr(bridge, name)) for name in bridge.__all__)
    files = {file.stem for file in (PACKAGE / topic).glob("*.py")}
    assert not files & set(bridge.__all__)
