"""The file of a page: everything is in it, no data are a script, wrong input says why."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import clplen
from clplen.errors import ShapeError
from clplen.io.page.html_page import script
from clplen.io.page.light_field_item import PageOptions, light_field_item
from clplen.io.page.samples import Content
from clplen.outputs import is_ours

RNG = np.random.default_rng(5)
VIEWS = RNG.integers(0, 256, (4, 5, 12, 17, 3), np.uint8)


class Scripts(HTMLParser):
    """Contents of script elements by their type and id, and all addresses."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.scripts: dict[tuple[str, str], str] = {}
        self.links: list[str] = []
        self.now: tuple[str, str] | None = None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        known = dict(attrs)
        self.links += [v for k, v in known.items() if k in ("src", "href", "action") and v]
        if tag == "script":
            self.now = (known.get("type", ""), known.get("id", ""))
            self.scripts[self.now] = ""

    def handle_endtag(self, tag):
        self.now = None if tag == "script" else self.now

    def handle_data(self, data):
        if self.now:
            self.scripts[self.now] += data


def written(path: Path, *subject, **words) -> Scripts:
    clplen.io.write_html(path, *subject, **words)
    return Scripts(path.read_text(encoding="utf-8"))


def content_of(page: Scripts) -> dict:
    return json.loads(page.scripts["application/json", "clplen-content"])


def test_a_page_holds_its_data_and_asks_nobody(tmp_path):
    path = tmp_path / "page.html"
    page = written(path, clplen.LightField.from_array(VIEWS))
    content = content_of(page)
    (item,) = content["items"]
    assert item["shape"] == [4, 5, 12, 17, 3]
    assert len(content["sizes"]) == 20
    assert len([key for key in page.scripts if key[0] == "text/plain"]) == 20
    assert page.links == ["data:,"]
    assert re.findall(r"https?://(?!www\.w3\.org/2000/svg)", path.read_text()) == []
    assert "default-src 'none'" in path.read_text()
    assert is_ours(path)


def test_names_are_no_markup(tmp_path):
    for name in ["</script><script>alert(1)</script>", "<!--<script>", "a & b \u2028"]:
        page = written(tmp_path / "page.html", {name: VIEWS[0, 0]}, title=name)
        assert set(page.scripts) == {
            ("module", ""),
            ("application/json", "clplen-content"),
            ("text/plain", "clplen-data-0"),
        }
        assert content_of(page)["items"][0]["name"] == name


def test_modules_are_joined_without_imports():
    text = script("widget")
    assert not re.search(r"^(import|export) ", text, re.M)
    folder = Path(clplen.__file__).parent / "viewer" / "page"
    for file in folder.glob("*.js"):
        assert f"const {file.stem}_js = " in text


def test_arrays_by_their_axes(tmp_path):
    for subject, shape in [
        (RNG.random((7, 9)), [1, 1, 7, 9]),
        (RNG.random((7, 9, 3)), [1, 1, 7, 9, 3]),
        (RNG.random((4, 7, 9)), [1, 4, 7, 9]),
        (RNG.random((2, 3, 7, 9)), [2, 3, 7, 9]),
        (RNG.random((2, 3, 7, 9, 1)), [2, 3, 7, 9]),
    ]:
        assert content_of(written(tmp_path / "a.html", subject))["items"][0]["shape"] == shape


def test_results_by_their_kind(tmp_path):
    lf = clplen.LightField.from_array(VIEWS[..., 0], spacing=(-1e-3, -1e-3, 2e-5, 2e-5))
    stack = clplen.focal_stack(lf, disparities=[-1, 0, 1.5])
    depth = clplen.depth_map(stack)
    page = written(tmp_path / "a.html", [lf, stack, depth, lf.view(1, 2), lf.view(0, 0)])
    items = content_of(page)["items"]
    names = ["light field", "focal stack", "depth map", "picture 1", "picture 2"]
    assert [item["name"] for item in items] == names
    assert items[0]["pixel"] == [2e-5, 2e-5]
    assert items[1]["planes"]["values"] == pytest.approx(stack.alphas)
    assert items[2]["shown"]["table"] == "viridis"


def item(lf: clplen.LightField, **options) -> dict:
    return light_field_item(lf, Content(), name="it", options=PageOptions(**options))


def test_the_middle_views_are_kept_with_their_centre():
    lf = clplen.LightField.from_array(RNG.random((7, 10, 6, 8)).astype(np.float32))
    kept = item(lf, views=(4, 5))
    assert kept["shape"] == [3, 4, 6, 8]  # as odd and as even as before
    assert kept["full"]["first"] == [2, 3]
    assert np.allclose(np.mean(kept["steps"], axis=0), 0)
    assert np.ptp([step[1] for step in kept["steps"]]) == 3
    assert item(lf, views=(99, 99))["shape"] == [7, 10, 6, 8]


def test_disparities_of_smaller_pixels():
    camera_less = clplen.LightField.from_array(VIEWS, spacing=(-1e-4, -1e-4, 2e-5, 2e-5))
    whole, half = item(camera_less), item(camera_less, downscale=2)
    assert half["shape"] == [4, 5, 6, 8, 3]
    assert half["range"] == pytest.approx([end / 2 for end in whole["range"]])
    assert half["alpha"]["ratio"] == pytest.approx(whole["alpha"]["ratio"] / 2)
    assert half["pixel"] == [4e-5, 4e-5]


def test_options_out_of_range(tmp_path):
    for words, sentence in [
        ({"quality": 0}, "1 to 100"),
        ({"quality": 101}, "1 to 100"),
        ({"downscale": 0}, "positive integer"),
        ({"downscale": 1.5}, "positive integer"),
        ({"views": (0, 3)}, "at least 1 x 1"),
        ({"compare": True}, "at least two"),
    ]:
        with pytest.raises(ValueError, match=sentence):
            clplen.io.write_html(tmp_path / "a.html", VIEWS, **words)
        assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_shown(tmp_path):
    for subject, error, sentence in [
        ([], ValueError, "at least one light field"),
        (np.zeros(5), ShapeError, "two to five axes"),
        ("flower", TypeError, "got str"),
        (object(), TypeError, "got object"),
        (np.zeros((3, 3), complex), TypeError, "got ndarray"),
        (np.zeros((3, 3, 8, 9, 4), np.uint8), ShapeError, "one or three channels"),
        (np.full((3, 3, 8, 9), np.nan), ValueError, "NaN"),
    ]:
        with pytest.raises(error, match=sentence):
            clplen.io.write_html(tmp_path / "a.html", subject)
        assert list(tmp_path.iterdir()) == []


def test_another_suffix(tmp_path):
    with pytest.raises(ValueError, match=r"must end in \.html .* got .*a\.png"):
        clplen.io.write_html(tmp_path / "a.png", VIEWS)


def test_metres_by_the_lens_law_and_of_a_microscope(device):
    from clplen.demo import camera

    cam = camera(device, count=53)
    spacing = (-1e-3, -1e-3, cam.lenslet_pitch, cam.lenslet_pitch)
    lf = clplen.LightField.from_array(VIEWS, device=device, spacing=spacing, camera=cam)
    law = item(lf)["metres"]
    for d in (-0.3, 0.0, 0.11):
        z = 1 / (law["offset"] + law["slope"] * d) - law["object"]
        assert z == pytest.approx(float(cam.dz(lf.alpha(d))), rel=1e-6, abs=1e-12)
