"""``clplen sampling``: units, the report, the table of methods, lenses and lenslets."""

from __future__ import annotations

import math
import re
from itertools import product

import numpy as np
import pyopencl as cl
import pytest
from click.testing import CliRunner, Result

from clplen.cli import main
from clplen.cli.shared.options import Length, Lengths, Shape
from clplen.errors import SamplingError
from clplen.wave.elements.lens import check_lens_sampling, lens_sampling, lenslet_sampling
from clplen.wave.field.field import Grid
from clplen.wave.propagation.description import METHODS, Request, flops, samples_held
from clplen.wave.propagation.methods import describe
from clplen.wave.propagation.plan_report import report

pytestmark = pytest.mark.thorough

LAM = 550e-9
ONE = "fresnel-1fft"
THESIS = ("--pitch", "6.6um", "--shape", "3030", "--wavelength", "550nm")


def run(*words: object) -> Result:
    return CliRunner().invoke(main, ["sampling", *(str(word) for word in words)])


def said(*words: object) -> str:
    """Standard output of a command that succeeds, its runs of blanks made one."""
    result = run(*words)
    assert result.exit_code == 0, result.output
    return re.sub(r" +", " ", result.stdout)


def refused(*words: object) -> str:
    """The one sentence on standard error of a command that fails."""
    result = run(*words)
    assert result.exit_code in (1, 2)
    assert isinstance(result.exception, SystemExit)
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    return line


def test_lengths_are_those_of_python():
    for text, metres in (
        ("6.6um", 6.6e-6),
        ("6.6 um", 6.6e-6),
        ("6.6\u00b5m", 6.6e-6),
        ("6.6\u03bcm", 6.6e-6),
        ("550nm", 550e-9),
        (".55e3nm", 550e-9),
        ("700pm", 700e-12),
        ("-24cm", -0.24),
        ("240mm", 0.24),
        ("0.24", 0.24),
        ("2km", 2000.0),
        ("0", 0.0),
    ):
        assert Length().convert(text, None, None) == metres  # to the last bit


def test_pairs_are_y_and_x_and_share_the_last_unit():
    pair = Lengths()
    assert pair.convert("5umx6.6um", None, None) == (5e-6, 6.6e-6)
    assert pair.convert("5x6.6um", None, None) == (5e-6, 6.6e-6)
    assert pair.convert("5mm x 6.6um", None, None) == (5e-3, 6.6e-6)
    assert pair.convert("6.6um", None, None) == (6.6e-6, 6.6e-6)
    assert Lengths(accepts_single=False).convert("-1x2mm", None, None) == (-1e-3, 2e-3)
    assert Shape().convert("20x30", None, None) == (20, 30)
    assert Shape().convert("30", None, None) == (30, 30)


def test_bad_words_are_one_sentence():
    for words, message in (
        (["--z", "24o"], "'24o' is not a length: give a number with a unit"),
        (["--z", "6,6um"], "a decimal point, not a comma"),
        (["--z", "5nn"], "the units are pm, nm, um, mm, cm, m, km"),
        (["--z", "1e13m"], "out of range: use 1 pm to 1e12 m"),
        (["--pitch", "0"], "the length must be positive, got '0'"),
        (["--pitch", "1x2x3um"], "is not a pair YxX"),
        (["--shape", "3.5"], "'3.5' is not a number of samples: give a whole number"),
        (["--shape", "0"], "a side has 1 to 1,000,000 samples"),
        (["--method", "asm"], "'asm' is not one of 'auto', 'as'"),
        (["--pad", "nan", "--z", "1m"], "pad must be at least 1 and finite"),
        (["--out-offset", "5mm"], "give y and x, such as 0x5mm"),
        (["--lens", "0"], "the length must not be 0"),
        (["--diameter", "3mm"], "needs --lens or --lenslets"),
        (["--arriving", "3mm"], "--arriving needs --lens"),
        (["--z", "0", "--method", "fresnel-1fft"], "is 0 at z = 0"),
        (["--z", "1m", "--method", "as", "--out-pitch", "1um"], "--method cblas supports any grid"),
    ):
        assert message in refused(*THESIS, *words)


def test_no_device_is_needed(monkeypatch: pytest.MonkeyPatch):
    def none() -> None:
        raise AssertionError("a device was looked for")

    monkeypatch.setattr(cl, "get_platforms", none)
    assert "auto selects as: f_geo + guard >= f_nyq" in said(*THESIS, "--z", "240mm")


def test_the_figures_of_the_thesis():
    """dx = 6.6 um, N = 3030, z = .24 m, D = 3.6 mm."""
    words = ("--z", "240mm", "--lens", "120mm", "--diameter", "3.6mm", "--lenslets", "150um", "9mm")
    text = said(*THESIS, *words)
    assert "N dx^2/lam 240 mm" in text
    assert "fully sampled up to 239.8 mm" in text  # N dx^2 sqrt(1 - q^2)/lam, q = lam/(2 dx)
    assert "Nyquist 75.76 cycles/mm, half angle 2.388 deg, NA 0.0417" in text
    assert "f_min = D dx/lam = 43.2 mm" in text
    assert "R = 1.8 mm; R_max = lam f/(2 dx) = 5 mm: sampled" in text
    assert "f/33.33; fastest sampled dx/lam: f/12" in text
    # D/(2 z) = .0075: d/(2 f_mu) <= .041667 - .0075
    assert "plane wave d/(2 f) = 0.008333; limit lam/(2 dx) = 0.04167: sampled, " in text
    assert "for f from 1.8 mm on" in text
    assert "lens 240 mm away d/(2 f) = 0.008333 + D/(2 z) = 0.0075;" in text
    assert "for f from 2.195 mm on" in text
    finer = said("--pitch", "5um", *THESIS[2:], "--lenslets", "150um", "1.3mm")
    assert "aliased, for f from 1.364 mm on" in finer


def test_every_method_is_judged_at_every_distance():
    text = said(*THESIS, "--z", "10cm", "--z", "-1m", "--z", "0")
    rows = dict(re.findall(r"^ ([a-z0-9-]+) ((?:any|up to|from).*)$", text, re.MULTILINE))
    assert set(rows) == set(METHODS[1:])
    field = "yes, the field"
    assert rows["as"] == f"up to 479.5 mm yes no {field}"
    assert rows["blas"] == f"any yes yes, 23 % of band {field}"
    assert rows["cblas"] == f"any yes yes {field}"
    assert rows["rs"] == f"from 479.5 mm on no yes {field}"
    assert rows["one-step"] == f"from 16.36 m on no no {field}"  # two windows of 20 mm
    assert rows["fresnel-tf"] == f"up to 480 mm yes no {field}"
    assert rows["fresnel-ir"] == f"from 480 mm on no yes {field}"
    assert rows["fresnel-1fft"] == "from 240 mm on no yes, pitch 13.75 um no, pitch 0"
    # Whole steps of L dx^2/lam = 486.6 mm, L = 6144; 33 of them.
    steps = "yes, equal steps: 0 yes, equal steps: 2"
    assert rows["fresnel-multistep"] == f"up to 16.06 m {steps} {field}"


@pytest.mark.parametrize("pad", [1, 1.5])
def test_the_verdict_is_that_of_the_plan(pad: float):
    """A method called sampled at a distance is one whose plan does not warn, and the reverse."""
    z = np.geomspace(1e-3, 3, 12)
    words = [word for one in z for word in ("--z", one)]
    grid = ("--pitch", "5x6.6um", "--shape", "130x97", "--wavelength", LAM, "--pad", pad)
    text = run(*grid, *words).stdout
    for method in METHODS[1:]:
        (row,) = [row for row in text.splitlines() if row.startswith(f"  {method}  ")]
        cells = re.split(r"  +", row.strip())[2:]
        assert len(cells) == z.size
        for one, cell in zip(z, cells, strict=True):
            wanted = Request(Grid((130, 97), (5e-6, 6.6e-6)), one, LAM, method, pad)
            made = describe(wanted)
            warned = bool(made.warning)
            # Of the periodic operator nothing is said, but a phase step above pi is.
            if pad == 1 and method not in ("fresnel-multistep", "one-step"):
                warned = made.phase_step > 1 and method in ("rs", "fresnel-tf", "fresnel-ir", ONE)
            assert cell.startswith("no" if warned else "yes"), (method, one, made.phase_step)


def test_without_padding_the_window_is_the_grid():
    text = said(*THESIS, "--z", "1m", "--pad", "1")
    assert "as any, periodic yes" in text
    assert "fresnel-tf up to 240 mm no" in text


def test_an_aliased_propagation_is_a_note_not_a_failure():
    result = run(*THESIS, "--z", "1m", "--method", "as")
    assert result.exit_code == 0
    assert result.stderr.startswith("Note: The transfer function at z = 1 m is aliased")
    assert "Use --method auto or 'blas', or a larger pad." in result.stderr
    assert "auto would select" in result.stdout
    assert "tables, residual 2.74 turns" in result.stdout
    assert not run(*THESIS, "--z", "1m").stderr


def test_a_forgotten_unit_of_the_wavelength_is_noted():
    result = run(*THESIS[:-1], "0.01", "--z", "240mm")
    assert result.exit_code == 0
    assert "write for example 550nm" in result.stderr
    refused = run(*THESIS[:-1], "550", "--z", "240mm")
    assert refused.exit_code == 1
    assert "got 550; did you mean 5.5e-07?" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_two_axes_and_another_output():
    out = ("--out-pitch", "1um", "--out-shape", "100x101", "--out-offset", "-1x2mm")
    grid = ("--pitch", "5x6.6um", "--shape", "640x480", "--wavelength", "550nm")
    text = said(*grid, "--z", "1m", *out, "--support", "1mm")
    assert "samples 640 x 480 of 5 um x 6.6 um (y x)" in text
    assert "Nyquist y 100 cycles/mm, half angle 3.153 deg" in text
    assert "Nyquist x 75.76 cycles/mm, half angle 2.388 deg" in text
    assert "auto selects cblas: the output has another pitch or centre" in text
    assert "100 x 101 samples of 1 um, window 100 um x 101 um (y x), centre -1 mm x 2 mm" in text
    assert "blas any no, sets its own grid" in text
    assert "cblas any yes" in text


def test_a_line_of_samples_and_a_single_one():
    text = said("--pitch", "6.6um", "--shape", "1x1000", "--wavelength", "550nm", "--z", "10m")
    assert "window 6.6 mm at 550 nm" in text
    assert "band x 75.76 cycles/mm" in text
    assert "band y" not in text
    said("--pitch", "6.6um", "--shape", "1", "--wavelength", "550nm", "--z", "1m", "--lens", "1m")


def test_a_lens_wider_than_the_window_and_too_strong():
    result = run(*THESIS, "--lens", "10mm", "--diameter", "25mm")
    assert result.exit_code == 0
    assert "the window of 20 mm is smaller than the lens" in result.stderr
    assert "aliased beyond R_max = 416.7 um" in result.stderr
    assert ": aliased" in result.stdout


def test_a_lens_is_called_aliased_where_it_raises():
    grid = Grid((201, 300), (7e-6, 4e-6), origin=(0.0, 1e-4))
    for f, diameter in product((4e-3, -8e-3, 12e-3, 30e-3), (None, 1e-3, 5e-3)):
        found = lens_sampling(grid, f, wavelength=LAM, diameter=diameter)
        radius = None if diameter is None else diameter / 2
        if found.is_sampled(found.alone):
            check_lens_sampling(grid, f, radius, LAM, "raise")
        else:
            with pytest.raises(SamplingError, match=f"{found.shortest_focal_length:.4g} m"):
                check_lens_sampling(grid, f, radius, LAM, "raise")
        assert found.alone == pytest.approx(0.5 / found.f_number)


def test_slopes_of_light_are_those_of_its_phase():
    """Against finite differences of the phase at the rim, in waves a metre times lam."""
    for arriving in (math.inf, 0.03, -0.02):
        f, radius, h = 0.05, 2e-3, 1e-7
        found = lens_sampling(
            Grid((1024, 1024), 5e-6), f, wavelength=LAM, diameter=2 * radius, arriving=arriving
        )

        def path(r: float, arriving: float = arriving) -> float:
            return r * r / 2 * (1 / arriving - 1 / 0.05)

        slope = (path(radius + h) - path(radius - h)) / (2 * h)
        assert found.behind == pytest.approx(abs(slope), rel=1e-6)  # rounding of the difference
        assert found.arriving == pytest.approx(radius / abs(arriving))


def test_no_lenslets_behind_light_that_is_too_steep():
    found = lenslet_sampling(150e-6, 10e-3, samples=6.6e-6, wavelength=LAM, diameter=30e-3, z=-0.24)
    assert not found.is_sampled
    assert math.isinf(found.shortest_focal_length)
    edge = lenslet_sampling(150e-6, 1.8e-3, samples=6.6e-6, wavelength=LAM)
    assert edge.is_sampled  # exactly at d dx/lam


def test_operations_are_those_of_the_lines_that_hold_light():
    """3 x 5 samples in 6 x 10: 3 rows, 10 columns there and back, 3 rows."""
    made = describe(Request(Grid((3, 5), 5e-6), 1e-3, LAM, "as"))
    row, column = 50 * math.log2(10), 30 * math.log2(6)
    assert flops(made) == pytest.approx(3 * row + 20 * column + 3 * row)
    # A quadrant 4 x 6 of H; rows of 10 before and after y, 3 each; the result.
    assert samples_held(made) == 24 + 2 * 30 + 15
    line = describe(Request(Grid((1, 5), 5e-6), 1e-3, LAM, "fresnel-tf"))
    assert flops(line) == pytest.approx(2 * row)
    nothing = describe(Request(Grid((3, 5), 5e-6), 0.0, LAM))
    assert (flops(nothing), samples_held(nothing)) == (0, 0)


def test_the_report_reads_well():
    grid = Grid((3030, 3030), 6.6e-6)
    text = str(report(describe(Request(grid, 1.0, LAM, "fresnel-tf")), "tables"))
    rows = dict(re.split(r"  +", line, maxsplit=1) for line in text.splitlines())
    assert rows["distance"] == "1 m at 550 nm"
    assert rows["sampled for z"] == "up to 480 mm"
    assert rows["paraxial error"].startswith("up to 0.9")
    assert rows["warning"].startswith("Fresnel's transfer function at z = 1 m is aliased")
    note = run(*THESIS, "--z", "1m", "--method", "fresnel-tf").stderr
    assert note.endswith("Use --method fresnel-ir, or 'auto'.\n")
