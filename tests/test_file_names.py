"""Names of files in messages, as they were given, in every command and in jobs."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import click
import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from command_line import invoke, said
from microscope_commands import CAMERA, KNOWN

from clplen.cli import main
from clplen.config.example import EXAMPLE
from clplen.errors import FormatError, arguments_as
from clplen.io import read_lightfield

NAMES = (
    "white=1", "run-step=2/order='uvyxc'", "grid=a/dark=b", "views=(3, 4)", "force=True",
    "two  blanks", "it's", 'say "hi"', "it's \"both\"", "100 %s %d", "{stem} {0} {}", "a\nb",
    "tab\there", "h\u00e4\u00df \u5149\u573a", "back\\slash", "-o", "--white", "*?[x]",
    "#&;|$HOME", "$x_2$", "n" * 180, "\u202eright", "<b>&amp;", "pattern='a_{v}'", "or 'auto'",
)  # fmt: skip
WORDS = {  # of each command that takes files: its inputs, its output, what else it needs
    "analyse": "camera.toml -o out",
    "batch run": "job.toml --dry-run",
    "batch status": "job.toml",
    "bench": "--compare old.json",
    "calibrate": "board.png -o c.json --board 5x7 --spacing 1mm",
    "demo": "-o out",
    "depth": "lf.npy -o d.pfm",
    "epi": "lf.npy -o e.png",
    "info": "lf.npy",
    "lenticular": "lf.npy -o l.png --lpi 50 --width-mm 30",
    "microscope deconvolve": "frame.tif -c psf.h5 -o v.tif",
    "microscope points": "vol.tif -o p.csv",
    "microscope project": "vol.tif -c psf.h5 -o f.tif",
    "microscope psf": "known.toml -o p.h5",
    "microscope pupil": "frame.tif -c mic.toml -o p.h5 --planes-um -1:1:3",
    "microscope regions": "vol.tif -o r.csv",
    "microscope traces": "vol.tif -o t.csv",
    "microscope track": "vol.tif -o t.csv --step-um 1",
    "microscope views": "vol.tif -o v.gif",
    "poses": "lf.npy -o out --format nerfstudio",
    "quilt": "lf.npy -o q.png",
    "refocus": "lf.npy -o r.png",
    "render": "lf.npy -o r.gif",
    "score": "a.npy b.npy",
    "simulate": "camera.toml -o out",
    "stack": "lf.npy -o s.tif",
    "stereo": "lf.npy -o s.png",
    "view": "lf.npy -o v.html",
    "worker": "tcp://127.0.0.1:9 --certificates folder",
}
NO_FILES = {"devices", "sampling"}


def leaves(group: click.Group, *words: str) -> Iterator[tuple[str, click.Command]]:
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from leaves(command, *words, name)
        else:
            yield " ".join((*words, name)), command


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an input of each kind, beside which files of odd names are put."""
    monkeypatch.chdir(tmp_path)
    for name in ("lf", "a", "b"):
        np.save(f"{name}.npy", np.ones((3, 3, 9, 9)[2 * (name != "lf") :], np.float32))
    for name, text in (("camera", EXAMPLE), ("known", KNOWN), ("mic", CAMERA)):
        Path(f"{name}.toml").write_text(text)
    for name, shape in (("frame", (45, 45)), ("vol", (3, 9, 9))):
        tifffile.imwrite(f"{name}.tif", np.ones(shape, "f4"), photometric="minisblack")
    Path("job.toml").write_text('output = "o"\n[inputs]\nfiles = "*.npy"\n[stack]\n')
    return tmp_path


def places(words: list[str], command: click.Command) -> Iterator[tuple[list[str], bool]]:
    """Words with NAME in place of a file, and whether one of others lies there.

    Inputs are missing or of others, outputs and files of options of others.
    """
    first = next((at for at, word in enumerate(words) if word.startswith("-")), len(words))
    for at, word in enumerate(words):
        if "." in word or words[at - 1] in ("-o", "--certificates"):
            named = [*words[:at], f"NAME{Path(word).suffix}", *words[at + 1 :]]
            yield from ((named, exists) for exists in {True, at > first})
    for param in command.params:
        is_path = isinstance(param, click.Option) and isinstance(param.type, click.Path)
        if is_path and not {*param.opts} & {*words}:
            yield [*words, param.opts[-1], "NAME"], True


def said_of(command: str, words: list[str], name: str, *, exists: bool) -> str:
    """What a command says of a file of this name; nothing if it takes it."""
    (place,) = (word for word in words if "NAME" in word)
    file = place.replace("NAME", name)
    words = [f"./{file}" if word == place else word for word in words]
    path = Path(file)
    path.parent.mkdir(exist_ok=True)
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    if exists:
        path.write_text("of others\n")
    result = invoke(*command.split(), *words)
    assert not exists or path.read_bytes() == b"of others\n", (command, words)
    return said(result, result.exit_code) if result.exit_code else ""


def test_every_command(folder: Path):
    commands = dict(leaves(main))
    assert commands.keys() == {*WORDS, "devices", "sampling"}  # these two take no files
    named = 0  # places whose file a message names; each takes a fifth of the names in turn
    for command, line in WORDS.items():
        for words, exists in places(line.split(), commands[command]):
            if "plain" in said_of(command, words, "plain", exists=exists):
                named += 1
                for name in NAMES[named % 5 :: 5]:
                    assert name in said_of(command, words, name, exists=exists), command
    assert named > 50


def test_a_job(folder: Path):
    """Inputs that are no light fields: in the run and in what its status shows afterwards."""
    job = 'output = "o"\n[[inputs]]\nfiles = "**/*.bad"\nname = "{index}"\n[stack]\n'
    Path("job.toml").write_text(job)
    for name in NAMES:
        path = Path(f"{name}.bad")
        path.parent.mkdir(exist_ok=True)
        path.write_text("of others\n")
    for words in (("batch", "job.toml"), ("batch", "status", "job.toml")):
        text = invoke(*words).output
        assert [name for name in NAMES if f"{name}.bad" not in text] == []


def test_words_of_arguments_in_names_stay(folder: Path):
    """Only the argument is written as the surface in use has it."""
    Path("white=1.png").mkdir()
    for view in ("0_0", "0_1", "1_0"):
        imageio.imwrite(f"white=1.png/{view}.png", np.full((9, 9), 7, np.uint8))
    for surface, words in (
        ("python", "allow_missing=True"), ("file", "allow_missing = true"),
        ("command", "--allow-missing"),
    ):  # fmt: skip
        with arguments_as(surface), pytest.raises(FormatError) as error:
            read_lightfield("white=1.png")
        assert "missing in white=1.png (" in str(error.value)
        assert f"Give them weight 0 by {words}." in str(error.value)
