"""The viewer in a notebook: a widget where there is anywidget, else a page in a frame."""

from __future__ import annotations

import html
import importlib.util

import numpy as np
import pytest

import clplen
from clplen.viewer import notebook

RNG = np.random.default_rng(7)
VIEWS = RNG.integers(0, 256, (3, 5, 21, 25, 3), np.uint8)


@pytest.fixture
def plain(monkeypatch):
    """No anywidget."""
    find = importlib.util.find_spec
    monkeypatch.setattr(notebook, "find_spec", lambda name: None if name == "anywidget" else find)


def test_a_page_in_a_frame(plain):
    shown = clplen.view(VIEWS, title='a "b" <c>', height=300)
    text = shown._repr_html_()
    assert text.startswith('<iframe srcdoc="&lt;!doctype html&gt;')
    assert text.count("<") == 2
    assert "height: 300px" in text
    assert "allow-same-origin" not in text
    assert html.unescape(text).count('id="clplen-data-') == 15
    assert repr(shown).startswith("<PageFrame ")


def test_a_height_that_is_none(plain):
    for height in [0, 199, -5]:
        with pytest.raises(ValueError, match="at least 200 pixels"):
            clplen.view(VIEWS, height=height)


def test_the_widget_answers(monkeypatch):
    pytest.importorskip("anywidget", reason="anywidget is not installed: pip install '.[notebook]'")
    lf = clplen.LightField.from_array(VIEWS)
    widget = clplen.view({"it": lf, "picture": lf.view(1, 2)})
    assert [item["name"] for item in widget.content["items"]] == ["it", "picture"]
    assert widget.computes
    sent: list = []
    monkeypatch.setattr(widget, "send", lambda *a, **k: sent.append((a, k)), raising=False)
    state = {"shape": "all", "v": 1.0, "u": 2.0, "d": 0.4}
    asked = {"id": 5, "channel": "picture", "request": {"item": 0, "kind": "picture"}}
    widget._handle_custom_msg({**asked, "request": {**asked["request"], "state": state}}, [])
    (message,), words = sent[-1]
    assert message["result"]["shape"] == [21, 25, 3]
    assert len(words["buffers"]) == 1
    widget._handle_custom_msg(asked, [])
    assert "aperture" in sent[-1][0][0]["error"]
    widget._handle_custom_msg({**asked, "request": {"item": 1, "kind": "depth"}}, [])
    assert "no light field" in sent[-1][0][0]["error"]
    count = len(sent)
    widget._handle_custom_msg("nonsense", [])
    assert len(sent) == count
