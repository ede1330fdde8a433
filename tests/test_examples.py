"""Every figure script runs, draws a picture and prints its numbers; the table names them all."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from figure_scripts import Done, run_script
from matplotlib.image import imread

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(EXAMPLES.glob("fig_*.py"))
NUMBER = re.compile(r"^  (.+?) +(\S+)   reference +(\S+) \+- (\S+)(   .+)?$", re.MULTILINE)
ROW = re.compile(r"\| (\d+)\.(\d+) (.+?) \| \[(\S+)\]\((\S+)\)[^|]* \| (.+?) \| (.+?) \|")
SHORTER_THAN = 60  # lines
EACH = 20  # one script in so many is run by default
FRAMES = ("guv_volume", "guv_variations", "bead_positions", "bead_volume")
THESIS = {1: range(1, 27), 2: range(1, 30), 3: range(1, 26), 5: range(1, 3)}  # its list of figures
ADDED = {4: range(1, 8), 5: range(1, 6), 6: range(1, 6), 7: range(1, 3)}
FIGURES = THESIS | ADDED


def run(script: Path, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a script in a new process, from another folder."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, str(script), *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        timeout=300,
        check=False,
    )


def row_of(script: Path) -> str:
    """The script's row in the table of figures."""
    rows = [
        line
        for line in (EXAMPLES / "README.md").read_text().splitlines()
        if line.startswith("|") and f"({script.name})" in line
    ]
    assert len(rows) == 1, f"{script.name} has {len(rows)} rows in examples/README.md"
    return rows[0]


def test_all_figures_are_there() -> None:
    figures = {f"fig_{chapter}_{figure}" for chapter in FIGURES for figure in FIGURES[chapter]}
    found = ["_".join(script.name.split("_")[:3]) for script in SCRIPTS]
    assert len(found) == len(set(found)), "two scripts draw one figure"
    assert set(found) == figures


def test_the_table_has_every_figure() -> None:
    """Under its chapter, once and in order: words, a script that is there, two lists of numbers."""
    table, chapter = {}, 0
    for line in (EXAMPLES / "README.md").read_text().splitlines():
        if line.startswith("## "):
            title = re.match(r"## Chapter (\d+): ", line)
            chapter = int(title[1]) if title else 0
        if not re.match(r"\| \d", line):
            continue
        row = ROW.fullmatch(line)
        assert row, f"not a row of figure, script, printed number and reference: {line}"
        number = int(row[1]), int(row[2])
        assert number[0] == chapter, f"{number} stands under chapter {chapter}"
        assert number not in table, f"{number} has two rows"
        assert row[4] == row[5], f"{row[4]} leads to {row[5]}"
        for name in re.findall(r"\((\S+\.py)\)", line):
            assert (EXAMPLES / name).is_file(), f"there is no {name}"
        assert row[4].startswith(f"fig_{row[1]}_{row[2]}_"), f"{row[4]} draws another figure"
        assert re.search(r"\d", row[6]), f"{number} prints no number"
        assert re.search(r"\d", row[7]), f"{number} has no reference"
        table[number] = row[4]
    wanted = [(chapter, figure) for chapter in FIGURES for figure in FIGURES[chapter]]
    assert list(table) == sorted(wanted)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One script in `EACH`; all of them take three minutes on two cores."""
    if "script" in metafunc.fixturenames:
        chosen = SCRIPTS if metafunc.config.getoption("--figures") else SCRIPTS[::EACH]
        metafunc.parametrize("script", chosen, ids=lambda script: script.stem)


@pytest.fixture(scope="module")
def runs(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[Path, tuple[Path, Future[Done]]]]:
    """The scripts that are tested, in their folders, as many at a time as there are cores."""
    devices = request.config.getoption("--device") or []
    chosen = ["--device", devices[0]] if devices else []
    wanted = [
        script
        for item in request.session.items
        if isinstance(item, pytest.Function) and item.originalname == "test_a_figure_script"
        for script in (item.callspec.params["script"],)
    ]
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=os.cpu_count(), mp_context=fresh) as pool:
        started = {}
        for script in wanted:
            folder = tmp_path_factory.mktemp(script.stem)
            done = pool.submit(run_script, script, ("--quick", "-o", "out", *chosen), folder)
            started[script] = (folder, done)
        yield started
        pool.shutdown(cancel_futures=True)


@pytest.mark.thorough
def test_a_figure_script(script: Path, runs: dict[Path, tuple[Path, Future[Done]]]) -> None:
    folder, started = runs[script]
    done = started.result()
    assert done.returncode == 0, done.stderr
    assert "UserWarning" not in done.stderr  # matplotlib's word on a layout that fails
    files = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    assert files == [Path("out", f"{script.stem}.png")]
    check_picture(folder / files[0])
    numbers = NUMBER.findall(done.stdout)
    assert numbers, done.stdout
    for what, value, reference, within, verdict in numbers:
        assert abs(float(value) - float(reference)) <= float(within), f"{what}\n{done.stdout}"
        assert not verdict, f"{what}\n{done.stdout}"
        assert reference in row_of(script), f"the table lacks {what}: {reference}"


def test_an_example_of_a_real_frame(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    """Quickly, on the frame or, where there is none, a simulated one."""
    for name in FRAMES:
        if not pytestconfig.getoption("--figures"):
            pytest.skip("examples of real frames take half a minute: pytest --figures runs them")
        devices = pytestconfig.getoption("--device") or []
        chosen = ["--device", devices[0]] if devices else []
        done = run(EXAMPLES / f"{name}.py", "--quick", "-o", "out", *chosen, folder=tmp_path)
        assert done.returncode == 0, done.stderr
        assert re.search(r"\d", done.stdout)
        for picture in tmp_path.rglob("*.png"):
            check_picture(picture)


def check_picture(path: Path) -> None:
    """A picture with lines or colours on it, none of them cut by its edge."""
    pixels = imread(path)[:, :, :3]
    assert min(pixels.shape[:2]) >= 500
    ink = (pixels < 0.9).any(axis=2)
    assert 0.02 < ink.mean() < 0.95
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 100
    for edge in (ink[0], ink[-1], ink[:, 0], ink[:, -1]):
        assert not edge.any()


def test_scripts_are_short_and_in_the_table() -> None:
    for script in SCRIPTS:
        assert len(script.read_text().splitlines()) < SHORTER_THAN, script.name
        assert row_of(script)


def test_a_number_out_of_tolerance_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for value, ending in [
        (1.2301, ""),
        (1.2349, ""),
        (1.2352, "OUT OF TOLERANCE"),
        (np.nan, "OUT OF TOLERANCE"),
    ]:
        monkeypatch.syspath_prepend(EXAMPLES)
        importlib.import_module("common").number("a length / mm", value, 1.23, 5e-3)
        ((what, found, reference, within, verdict),) = NUMBER.findall(capsys.readouterr().out)
        assert (what, reference, within) == ("a length / mm", "1.2300", "0.005")
        assert (found, verdict.strip()) == (f"{value:.4f}", ending)


@pytest.mark.thorough
def test_pictures_as_pdf_and_help(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    devices = pytestconfig.getoption("--device") or []
    chosen = ["--device", devices[0]] if devices else []
    script = EXAMPLES / "fig_2_10_lens_thickness.py"
    done = run(script, "--format", "pdf", *chosen, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    (file,) = (path for path in tmp_path.rglob("*") if path.is_file())
    assert file.name == "fig_2_10_lens_thickness.pdf"
    assert file.read_bytes().startswith(b"%PDF")
    assert "lenslets" not in run(script, "--help", folder=tmp_path).stdout


def test_bad_options_get_a_sentence(tmp_path: Path) -> None:
    for arguments, words in [
        (("--device", "abacus"), "abacus"),
        (("-o", "taken"), "there is a file of this name"),
    ]:
        (tmp_path / "taken").touch()
        done = run(SCRIPTS[0], *arguments, folder=tmp_path)
        assert done.returncode == 2
        assert words in done.stderr
        assert "Traceback" not in done.stderr
