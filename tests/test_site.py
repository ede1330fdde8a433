"""What the documentation site is made of: pictures of the gallery, keys of TOML files, links."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import json
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

from clplen import plot

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
GENERATED = ("figures", "generated")
LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)|!\[[^\]]*\]\(([^)\s]+)\)")


def load(path: str) -> ModuleType:
    """A module of docs/ that is in no package."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, DOCS / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.thorough
def test_pictures_of_the_gallery_are_those_of_the_scripts() -> None:
    """Every script that draws has a small picture, made of the script as it is."""
    pictures = load("gallery/make_pictures.py")
    runs = json.loads((DOCS / "gallery/runs.json").read_text())
    assert list(runs) == pictures.scripts()
    for name, run in runs.items():
        assert run["digest"] == pictures.digest(name), f"make_pictures.py {name} has not been run"
    files = sorted((DOCS / "gallery/pictures").iterdir())
    assert {file.stem for file in files} >= {name for name in runs if name.startswith("fig_")}
    for file in files:
        assert file.stat().st_size <= pictures.LARGEST
        with Image.open(file) as picture:
            assert picture.width >= 400


def test_a_changed_script_or_module_changes_the_digest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = load("gallery/make_pictures.py")
    for name, text in {"fig_1": "from shared import x\n", "shared": "x = 1\n"}.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(pictures, "EXAMPLES", tmp_path)
    before = pictures.digest("fig_1")
    (tmp_path / "other.py").write_text("y = 1\n")
    assert pictures.digest("fig_1") == before
    (tmp_path / "shared.py").write_text("x = 2\n")
    assert pictures.digest("fig_1") != before


def test_every_figure_has_a_thumbnail() -> None:
    """Thumbnails show a part of the figure, and subjects are those of the filter."""
    settings = tomllib.loads((DOCS / "gallery/thumbnails.toml").read_text(encoding="utf-8"))
    subjects = settings.pop("subjects")
    names = {file.stem for file in (DOCS / "gallery/pictures").iterdir()}
    assert set(settings) == names
    assert {file.stem for file in (DOCS / "gallery/thumbnails").iterdir()} == names
    used = {subject for entry in settings.values() for subject in entry["subjects"]}
    assert used == set(subjects)
    for name, entry in settings.items():
        left, top, right, bottom = entry["box"]
        assert 0 <= left < right <= 1, name
        assert 0 <= top < bottom <= 1, name
        with Image.open(DOCS / f"gallery/thumbnails/{name}.webp") as picture:
            assert picture.size == (300, 200)


@pytest.mark.parametrize("folder", ["tutorials", "howto"])
def test_cards_of_an_index(folder: str) -> None:
    """Each page of the folder has a card, and each card has a picture and a sentence."""
    text = (DOCS / folder / "index.md").read_text(encoding="utf-8")
    card = r"^:link: (\S+)\n:link-type: doc\n:img-top: (\S+)\n:img-alt:\n\n(.+)\.$"
    cards = re.findall(card, text, re.MULTILINE)
    pages = [page for page, _, _ in cards]
    hidden = re.search(r"\{toctree\}\n:hidden:\n\n(.*?)\n```", text, re.DOTALL)
    assert hidden is not None
    assert sorted(pages) == sorted(hidden[1].split())
    assert {file.stem for file in (DOCS / folder).glob("*.md")} - {"index"} <= set(pages)
    for _, picture, sentence in cards:
        assert (DOCS / folder / picture).is_file()
        assert len(sentence.split()) <= 25


def test_printed_output_is_joined_without_breaks() -> None:
    pytest.importorskip("myst_nb", reason="Sphinx: pip install '.[docs]'")
    pieces = [("stdout", "3 floa"), ("stderr", "slow\n"), ("stdout", "t32\n")]
    outputs = [{"output_type": "stream", "name": name, "text": text} for name, text in pieces]
    joined = load("extensions/stream_output.py").join_streams(outputs)
    assert [(output["name"], output["text"]) for output in joined] == [
        ("stdout", "3 float32\n"),
        ("stderr", "slow\n"),
    ]


def test_users_of_a_public_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Imports, attributes and aliases lead to documented names; See Also names exist."""
    pytest.importorskip("sphinx", reason="Sphinx: pip install '.[docs]'")
    monkeypatch.syspath_prepend(str(DOCS / "extensions"))
    examples = load("extensions/api_examples.py")
    code = "import clplen\nfrom clplen import analysis as a\nclplen.plot.depth(a.score(x))"
    assert examples.names_in(code) == {"clplen.analysis.score", "clplen.plot.depth"}
    assert set(examples.related_names()) <= set(examples.documented().values())
    calls = tomllib.loads((DOCS / "images/plots.toml").read_text(encoding="utf-8"))["calls"]
    assert {f"clplen.plot.{name}" for name in calls} <= set(examples.documented().values())
    assert {file.stem for file in (DOCS / "images/plots").iterdir()} == set(calls)
    for name, call in calls.items():
        keywords = {keyword.arg for keyword in ast.parse(call, mode="eval").body.keywords}
        assert keywords <= set(inspect.signature(getattr(plot, name)).parameters), call


def test_keys_of_toml_files() -> None:
    pytest.importorskip("sphinx", reason="Sphinx: pip install '.[docs]'")
    from clplen.batch.jobs.spec import JobSpec
    from clplen.config.camera_file import CameraFile

    tables_of = load("extensions/toml_tables.py").tables_of
    camera = dict(tables_of(CameraFile.model_json_schema()))
    assert list(camera)[:3] == ["", "[camera]", "[camera.microlenses]"]
    rows = {row[0]: row[1:3] for row in camera["[camera]"]}
    assert rows["`focal_length_mm`"] == ["number > 0", "left out"]
    assert rows["`kind`"][0] == '`"plenoptic1"`, `"plenoptic2"`, `"microscope"`'
    assert rows["`wavelength_nm`"][1] == "required"
    assert rows["`microlenses`"] == ["table, below", "required"]
    assert "[[scene.pictures]]" in camera
    seed = {row[0]: row[1] for row in camera["[sensor]"]}["`seed`"]
    assert seed == "whole number >= 0 < 2^64"
    job = dict(tables_of(JobSpec.model_json_schema()))
    assert {"[[inputs]]", "[inputs.layout]", "[[simulations.sweep]]", "[stack]"} <= set(job)
    models = (CameraFile, JobSpec)
    for model, tables in zip(models, (camera, job), strict=True):
        top = {row[0].strip("`") for row in tables[""]}
        assert top == set(model.model_fields)


@cache
def anchors(page: Path) -> set[str]:
    """Names of the headings of a Markdown page, as links have them."""
    found = set()
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE):
        words = re.sub(r"[^\w\- ]", "", heading.lower())
        found.add(words.replace(" ", "-"))
    return found


def broken_links(page: Path) -> Iterator[str]:
    """Links of a page to files that do not exist, and to headings that a page lacks."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    generated = DOCS / "reference" / "commands"
    for match in LINK.findall(re.sub(r"`[^`\n]*`", "", text)):
        link = match[0] or match[1]
        if re.match(r"[a-z]+:", link):
            continue
        path, _, fragment = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if target.parent == generated and target.suffix == ".rst":
            continue  # made by the build, which checks it
        is_page = fragment and target.suffix == ".md"
        if not target.exists() or (is_page and fragment not in anchors(target)):
            yield f"{page.relative_to(ROOT)}: {link}"


def test_links_lead_somewhere() -> None:
    names = ("README", "CONTRIBUTING", "CHANGELOG", "examples/README", "kernels/README")
    pages = [ROOT / f"{name}.md" for name in names]
    pages += [path for path in DOCS.rglob("*.md") if path.parent.name not in GENERATED]
    assert [link for page in pages for link in broken_links(page)] == []


def test_links_of_the_built_site_are_checked(tmp_path: Path) -> None:
    faults = load("tools/links.py").faults
    (tmp_path / "a.html").write_text('<h1 id="here">A</h1><a href="b.html#there">b</a>')
    (tmp_path / "b.html").write_text('<p id="there"></p><a href="a.html#here">a</a>')
    assert list(faults(tmp_path)) == []
    output = '<div class="output stderr highlight-x"><pre>x.py:1: UserWarning: slow</pre></div>'
    (tmp_path / "b.html").write_text('<p id="there"></p><a href="a.html#here">a</a>' + output)
    assert list(faults(tmp_path)) == ["b.html prints x.py:1: UserWarning: slow"]
    (tmp_path / "b.html").write_text(
        '<a href="a.html#gone">a</a><a href="c.html">c</a><script src="https://x.org/y.js"></script>'
    )
    assert len(list(faults(tmp_path))) == 4
