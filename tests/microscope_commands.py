"""What tests of ``clplen microscope`` share: parameters, and running a command."""

from __future__ import annotations

from click.testing import CliRunner, Result

from clplen.cli import main

KNOWN = """
magnification = 60
na = 1.2
medium_index = 1.33
wavelength = 593
ulens_pitch = 100
ulens_focal_length = 2500
pixel_size = 6.666666667
num_slices = 3
um_per_slice = 2.5
supersample = 3
apodisation = 0.4
"""
CAMERA = """
[camera]
kind = "microscope"
magnification = 60
na = 1.2
medium_index = 1.33
wavelength_nm = 593
pixels_per_lenslet = 15
apodisation = 0.4
[camera.microlenses]
pitch_um = 100
focal_length_mm = 2.5
count = 9
fill = "full"
"""


def run(*words: object) -> Result:
    return CliRunner().invoke(main, ["microscope", *(str(word) for word in words)])


def done(result: Result) -> Result:
    assert result.exit_code == 0, result.output
    return result


def said(result: Result, code: int | None = None) -> str:
    """What went to standard error: one sentence, and no traceback."""
    assert result.exit_code in ((1, 2) if code is None else (code,)), result.output
    assert "Traceback" not in result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.stderr
