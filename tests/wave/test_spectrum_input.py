"""Spectra from files, long tables, and what is refused, each with one sentence."""

import math

import pytest

from clplen.errors import FormatError
from clplen.wave.spectrum.spectrum import Spectrum

TABLE = "# made up\nWavelength [{unit}], counts\n\n{rows}"
ROWS = ("500{e} , 1", "550{e}\t4 # peak", "600{e} 2")


def test_files(tmp_path):
    """Commas, spaces and tabs, header, comments, a micro sign in Latin-1; unit given or guessed."""
    for unit, e in [("nm", ""), ("um", "e-3"), ("m", "e-9")]:
        for given in [True, False]:
            path = tmp_path / "led.csv"
            text = TABLE.format(unit="\u00b5m", rows="\n".join(ROWS).format(e=e))
            path.write_bytes(text.encode("latin-1"))
            found = Spectrum.read(path, unit=unit if given else None)
            assert found == Spectrum.tabulated([500e-9, 550e-9, 600e-9], [1, 4, 2])
            path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(ROWS).format(e=e).encode())
            assert Spectrum.read(str(path), unit=unit if given else None) == found


def test_bad_files(tmp_path):
    for text, words in [
        ("500 1\n600 2\n550 3", "line 3: wavelengths must rise, got 550 nm after 600 nm"),
        ("l v\n500 1\n600 -2", "line 3: the value -2 is negative"),
        ("500 1\n600 nan", "line 2: '600 nan' is not a wavelength and a value"),
        ("500,5 1\n600,5 2", "line 1: '500,5 1' is not a wavelength and a value"),
        ("500;1\n600;2", "line 1: '500;1' is not"),
        ("500 1\nend 2", "line 2: 'end 2' is not"),
        ("500 1", "at least two points, got 1"),
        ("# nothing", "contains no numbers"),
        ("500 0\n600 0", "every value is 0"),
        ("4000 1\n7000 2", "from 4000 to 7000 is ambiguous; set unit="),
        ("0.05 1\n0.06 2", "from 0.05 to 0.06 is ambiguous"),
        ("0.05 1\n600 2", "from 0.05 to 600 is ambiguous"),
        ("a\0b", "not a text file"),
    ]:
        path = tmp_path / "bad.txt"
        path.write_text(text)
        with pytest.raises(FormatError) as caught:
            Spectrum.read(path)
        assert words in str(caught.value)
        assert str(path) in str(caught.value)


def test_files_of_the_wrong_kind(tmp_path):
    with pytest.raises(FormatError, match="There is no file"):
        Spectrum.read(tmp_path / "none.txt")
    (tmp_path / "led.txt").write_text("500 1\n600 2")
    with pytest.raises(ValueError, match="unit must be 'm', 'um', 'nm' or None"):
        Spectrum.read(tmp_path / "led.txt", unit="angstrom")
    with pytest.raises(
        FormatError, match=r"line 1: 500 m is not a wavelength .* did you mean 500e-9"
    ):
        Spectrum.read(tmp_path / "led.txt", unit="m")


LIGHT = Spectrum.gaussian(550e-9, 30e-9)
BAD = [
    (lambda: Spectrum.monochromatic(633), r"^633 m is not a .* in metres, did you mean 633e-9\?$"),
    (lambda: Spectrum.gaussian(0.633, 1e-9), r"did you mean 0\.633e-6\?$"),
    (lambda: Spectrum.gaussian(-5e-7, 1e-9), "-5e-07 m is not a wavelength"),
    (lambda: Spectrum.gaussian(math.nan, 1e-9), "finite number of metres, got nan"),
    (lambda: Spectrum.gaussian("550 nm", 1e-9), "finite number of metres, got '550 nm'"),
    (
        lambda: Spectrum.gaussian(5e-7, 30),
        r"FWHM must be positive .* got 30 m, did you mean 30e-9\?$",
    ),
    (lambda: Spectrum.gaussian(5e-7, 0), "FWHM must be positive"),
    (lambda: Spectrum.gaussian(5e-7, 3e-7), "half the wavelength, 250 nm, got 3e-07"),
    (lambda: Spectrum.rectangular(5e-7, -1e-9), "width must be positive"),
    (lambda: Spectrum.mercury(fwhm=math.inf), "FWHM must be positive"),
    (lambda: Spectrum.lines([5e-7, 6e-7], [1]), r"rows of equal length.*\(2,\) and \(1,\)"),
    (lambda: Spectrum.lines([], []), "rows of equal length"),
    (lambda: Spectrum.lines([5e-7], [-1]), "not negative and not all 0"),
    (lambda: Spectrum.lines([5e-7, 6e-7], [0, 0]), "not negative and not all 0"),
    (lambda: Spectrum.lines([546, 577], [1, 1]), "did you mean 546e-9"),
    (lambda: Spectrum.tabulated([4e-7, 6e-7, 5e-7], [1, 1, 1]), "Point 2 .* got 500 nm after"),
    (lambda: Spectrum.tabulated([4e-7, 4e-7], [1, 1]), "Point 1 .* got 400 nm after 400 nm"),
    (lambda: Spectrum.tabulated([400, 500], [1, 1]), "Point 0 .* did you mean 400e-9"),
    (lambda: Spectrum.tabulated([4e-7, 5e-7], [1, -1]), "Point 1 .* -1 is negative"),
    (lambda: Spectrum.tabulated([4e-7, 5e-7], [1, math.inf]), "Point 1 .* inf is not a number"),
    (lambda: Spectrum.tabulated([4e-7, 5e-7], [0, 0]), "empty: every value is 0"),
    (lambda: Spectrum.tabulated([4e-7], [1]), "at least two points, got 1"),
    (lambda: Spectrum.tabulated([4e-7, 5e-7], [1, 1, 1]), r"\(2,\) and \(3,\)"),
    (lambda: LIGHT.sample(0), "at least 1, got 0"),
    (lambda: LIGHT.sample(2.5), "at least 1, got 2.5"),
    (lambda: LIGHT.sample(9, span=0), "positive number of widths, got 0"),
    (lambda: LIGHT.sample(9, span=20), "span=20 widths .* reach frequency 0"),
    (lambda: LIGHT.error(9, -1.0), "at least 0, in metres, got -1.0"),
    (lambda: LIGHT.needed(math.inf), "at least 0, in metres, got inf"),
    (lambda: LIGHT.coherence_length("half"), "'goodman', 'fwhm' or 'oct', got 'half'"),
    (lambda: Spectrum.mercury().density(5e14), "set fwhm="),
]


def test_bad_input_gets_a_sentence():
    for call, words in BAD:
        with pytest.raises(ValueError, match=words):
            call()
