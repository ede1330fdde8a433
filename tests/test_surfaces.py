"""Python, files and commands take the same settings, and refuse wrong ones in the same words."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from command_line import done

import clplen
from clplen import Device, LightField
from clplen.cli import main
from clplen.microscopy import DeconvolutionSettings
from clplen.settings.declaration import Setting, setting_of
from clplen.settings.light_fields import (
    AllInFocusSettings,
    DepthSettings,
    StackSettings,
)
from clplen.settings.reading import ReadingSettings

SHAPE = (3, 5, 19, 23)
NAN = math.nan
MODELS: dict[str, tuple[type, str]] = {  # the model of a table, and the command with its options
    "stack": (StackSettings, "stack"),
    "depth": (DepthSettings, "depth"),
    "all_in_focus": (AllInFocusSettings, "refocus --all-in-focus"),
    "inputs.layout": (ReadingSettings, "info"),
    "deconvolve": (DeconvolutionSettings, "microscope deconvolve -c psf.h5"),
}
WRONG: tuple[tuple[str, str, Any, str], ...] = (  # table, argument, value, what it must be
    ("stack", "aperture", 0, "must be views across (9), a fraction of the diameter (0.5) or"),
    ("stack", "aperture", -3, "must be views across (9)"),
    ("stack", "aperture", 1.5, "must be views across (9)"),
    ("stack", "aperture", NAN, "must be views across (9)"),
    ("stack", "aperture", "f/0", "must be views across (9)"),
    ("stack", "aperture", "wide", "must be views across (9)"),
    ("stack", "interpolation", "quintic", "must be 'linear', 'nearest', 'cubic' or 'fourier'"),
    ("stack", "disparities", "1:2", "must be START:STOP:N with 1 to 1,000,000 planes"),
    ("stack", "disparities", "0:1:0", "must be START:STOP:N with 1 to 1,000,000 planes"),
    ("stack", "disparities", "a:b:c", "must be START:STOP:N with 1 to 1,000,000 planes"),
    ("stack", "alphas", "0.8:0.8:3", "must have at least 2 planes between two different ends"),
    ("depth", "aperture", 0, "must be views across (9), a fraction of the diameter (0.5) or"),
    ("depth", "aperture", "wide", "must be views across (9)"),
    ("depth", "cue", "sharpness", "must be 'energy', 'correspondence', 'structure-tensor' or"),
    ("depth", "disparities", "0:inf:5", "must be START:STOP:N with 1 to 1,000,000 planes"),
    ("depth", "alphas", "1:1:5", "must have at least 2 planes between two different ends"),
    ("all_in_focus", "disparities", "1;2;3", "must be START:STOP:N with 1 to 1,000,000 planes"),
    ("inputs.layout", "views", (0, 3), "must be two whole numbers from 1 on"),
    ("inputs.layout", "step", 0.0, "must be a positive number"),
    ("inputs.layout", "step", -1.5, "must be a positive number"),
    ("inputs.layout", "lattice", "round", "must be 'square' or 'hexagonal'"),
    ("inputs.layout", "bayer", "RGBG", "must be 'RGGB', 'BGGR', 'GRBG' or 'GBRG'"),
    ("inputs.layout", "demosaic", "later", "must be 'within', 'after' or 'before'"),
    ("inputs.layout", "max_bytes", "lots", "must be a whole number of bytes or a size such as"),
    ("inputs.layout", "max_bytes", 0, "must be 1 byte or more"),
    ("deconvolve", "iterations", 0, "must be a whole number from 1 on"),
    ("deconvolve", "iterations", 2.5, "must be a whole number from 1 on"),
    ("deconvolve", "background", -1.0, "must be a number from 0 on"),
    ("deconvolve", "gain", 0.0, "must be a positive number"),
    ("deconvolve", "gain", NAN, "must be a positive number"),
    ("deconvolve", "saturation", "full", "must be a positive number"),
    ("deconvolve", "residual", "low", "must be a positive number or 'noise'"),
    ("deconvolve", "prior", "l1", "must be 'tv', 'gaussian' or 'time'"),
    ("deconvolve", "start", "warm", "must be 'previous', 'decayed' or 'limited'"),
    ("deconvolve", "motion", -1e-6, "must be a positive number"),
    ("deconvolve", "batch", 0, "must be a whole number from 1 on"),
    ("deconvolve", "rolling", 1.5, "must be a whole number from 1 on"),
)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, device: Device) -> Path:
    views = np.random.default_rng(4).random(SHAPE, dtype=np.float32)
    path = tmp_path_factory.mktemp("surfaces") / "light.h5"
    clplen.write_lightfield(path, LightField.from_array(views, device=device))
    return path


def test_wrong_values_are_refused_in_the_same_words(tmp_path: Path, file: Path) -> None:
    for table, argument, value, rule in WRONG:
        model, command = MODELS[table]
        one = setting_of(model, argument)
        with pytest.raises(ValueError, match="must") as error:
            model(**{argument: value})
        python = str(error.value)
        assert python.startswith(f"{argument} {rule}"), python
        in_file = value * 1e6 if one.unit == "um" else value
        got = repr(list(in_file) if isinstance(in_file, tuple) else in_file)
        job = _job(tmp_path, file, table, one, in_file)
        with pytest.raises(clplen.FormatError, match="must") as wrong:
            clplen.batch.Job.read(job)
        where = "inputs.0.layout" if table == "inputs.layout" else table
        rest = python.removeprefix(argument).rpartition(", got ")[0]
        assert f"{job}: {where}.{one.key}{rest}, got {got}." == str(wrong.value)
        option = f"--{one.key.replace('_', '-')}"
        given = in_file if isinstance(in_file, tuple) else (in_file,)
        words = [*command.split(), str(file), option, *map(str, given)]
        words += [] if command == "info" else ["-o", str(tmp_path / "out.tif")]
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 2, (words, result.output)
        said = " ".join(result.output.split())
        assert re.search(f"value for '{option}'( / [^ ]+)?:{re.escape(rest)}, got ", said), said


def test_settings_that_need_another_one(tmp_path: Path, file: Path) -> None:
    for argument, value, option, rule in (
        ("strength", 2.0, "--strength 2", "needs prior: give tv, gaussian or time"),
        ("motion", 1e-6, "--motion-um 1", "needs start limited: give it, or leave both out"),
        ("haze", 1, None, "must be true or false"),
    ):
        one = setting_of(DeconvolutionSettings, argument)
        with pytest.raises(ValueError, match=f"^{argument} {rule}"):
            DeconvolutionSettings(**{argument: value})
        in_file = value * 1e6 if one.unit else value
        with pytest.raises(clplen.FormatError, match=f": deconvolve.{one.key} {rule}"):
            clplen.batch.Job.read(_job(tmp_path, file, "deconvolve", one, in_file))
        if option is not None:
            words = [*MODELS["deconvolve"][1].split(), "a.tif", "-o", "v.tif", *option.split()]
            result = CliRunner().invoke(main, words)
            assert result.exit_code == 2
            said = result.stderr.replace("needs --", "needs ")
            assert f"Error: {option.split()[0]} {rule}" in said


def _job(folder: Path, file: Path, table: str, one: Setting, value: Any) -> Path:
    """Write a job with one setting of one table."""
    text = "nan" if value != value else json.dumps(value)
    line = f"[{table}]\n{one.key} = {text}\n"
    if table == "inputs.layout":
        tables = f'[[inputs]]\nfiles = "{file}"\n{line}[stack]\n'
    else:
        psf = 'psf = "psf.h5"\n' if table == "deconvolve" else ""
        tables = f'[[inputs]]\nfiles = "{file}"\n{line}{psf}'
    path = folder / "job.toml"
    path.write_text(f'output = "out"\n{tables}')
    return path


def test_settings_of_python_files_and_commands_give_the_same_bits(
    tmp_path: Path, file: Path, device: Device
) -> None:
    lf = clplen.read_lightfield(file, device=device, flip_v=True, swap_uv=True)
    planes = np.linspace(-1, 1, 5)
    python = {
        "stack": clplen.focal_stack(
            lf, disparities="-1:1:5", aperture=0.8, interpolation="cubic"
        ).to_numpy(),
        "depth": clplen.depth_map(
            lf, cue="correspondence", disparities=planes, aperture=0.8
        ).disparity,
        "view_1.5_0": lf.view(1.5, 0).to_numpy(),
        "lightfield": lf.to_numpy(),
    }
    (tmp_path / "job.toml").write_text(
        f'output = "out"\n[[inputs]]\nfiles = "{file}"\nname = "one"\n'
        "layout = {flip_v = true, swap_uv = true}\n"
        '[stack]\ndisparities = "-1:1:5"\naperture = 0.8\ninterpolation = "cubic"\n'
        '[depth]\ncue = "correspondence"\naperture = 0.8\n'
        "disparities = [-1.0, -0.5, 0.0, 0.5, 1.0]\n"
        "[views]\nat = [[1.5, 0]]\n[light_field]\n"
    )
    said = clplen.batch.run_job(clplen.batch.Job.read(tmp_path / "job.toml"), device=device.name)
    assert not said.failed
    made = dict(_read(tmp_path / "out" / "one"))
    for name, values in python.items():
        assert np.array_equal(made[name], values), name
    layout = ("--flip-v", "--swap-uv", "--device", device.name)
    planes_of = ("--disparities", "-1:1:5")
    for command, name in (
        (("stack", "--aperture", "0.8", "--interpolation", "cubic", *planes_of), "stack"),
        (("depth", "--cue", "correspondence", "--aperture", "0.8", *planes_of), "depth"),
        (("render", "--viewpoint", "1.5", "0"), "view_1.5_0"),
    ):
        first, *more = command
        output = tmp_path / f"{name}.tif"
        done(CliRunner().invoke(main, [first, str(file), "-o", str(output), *more, *layout]))
        assert np.array_equal(_values(output), python[name]), name


def _read(folder: Path) -> Iterator[tuple[str, Any]]:
    for path in folder.iterdir():
        name = path.name.removesuffix(".ome.tif").removesuffix(".h5")
        if path.suffix == ".tif":
            yield name, _values(path)
        elif path.suffix == ".h5":
            yield name, clplen.read_lightfield(path).to_numpy()


def _values(path: Path) -> Any:
    if path.name.startswith("stack"):
        return clplen.io.read_stack(path).to_numpy()
    read = clplen.io.read_disparity if path.name.startswith("depth") else clplen.io.read_picture
    return read(path)
