"""Patterns of file names: what is matched, ranked, missing and guessed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from refusals import refused

from clplen.errors import FormatError
from clplen.io.lightfields.lightfield_files import kind_of
from clplen.io.lightfields.view_names import Pattern, arrange, guess, views_only


def grid(template: str, vs: range, us: range) -> list[str]:
    return [template.format(v=v, u=u) for v in vs for u in us]


def test_which_file_is_which_view():
    for pattern, names, words, shape, view, file in [
        # the first number and the step do not matter
        ("a_{v}_{u}.png", grid("a_{v:03d}_{u}.png", range(3, 12, 4), range(10, 40, 5)), {},
         (3, 6), (2, 1), "a_011_15.png"),
        # a counter and anything are ignored
        ("*_{n}_{u}_{v}.png", ["x9_07_02_01.png", "y10_08_02_02.png", "thumbs.db"], {},
         (2, 1), (1, 0), "y10_08_02_02.png"),
        # rows are counted by columns, a square count is a square, a missing row leaves a gap
        ("cam{i}.png", [f"cam{i:03d}.png" for i in range(6)], {"views": (2, 3)},
         (2, 3), (1, 0), "cam003.png"),
        ("{i}.png", [f"{i}.png" for i in range(1, 10)], {}, (3, 3), (2, 2), "9.png"),
        ("{v}_{u}", ["0_0", "0_1", "1_0", "1_1", "3_0", "3_1"], {}, (4, 2), (3, 1), "3_1"),
        # every other row is counted backwards
        ("{i}.png", [f"{i}.png" for i in range(1, 7)], {"views": (2, 3), "lawnmower": True},
         (2, 3), (1, 0), "6.png"),
    ]:  # fmt: skip
        found, files = arrange(Pattern(pattern), names, **words)
        assert found == shape
        assert files[view] == file
        assert len(files) == len([name for name in names if name != "thumbs.db"])


def test_names_that_fit_no_views():
    def arranged(pattern: str, names: list[str], **words: Any) -> Callable[[], Any]:
        return lambda: arrange(Pattern(pattern), names, **words)

    six, rows = [f"{i}.png" for i in range(6)], grid("{v}_{u}", range(2), range(3))
    refused(
        (FormatError, r"6 views, not a square number.*views=\(V, U\)", arranged("{i}.png", six)),
        (FormatError, r"views=\(1, 5\) must cover", arranged("{i}.png", six, views=(1, 5))),
        (FormatError, r"views=\(3, 2\) must equal 2 x 3", arranged("{v}_{u}", rows, views=(3, 2))),
        (FormatError, r"same view: 1_2 and 01_2", arranged("{v}_{u}", ["1_2", "01_2"])),
        (FormatError, r"in D matches .*'\{v\}x\{u\}'.*a, b, c",
         arranged("{v}x{u}", ["b", "a", "c", "d"], where="D")),
        (ValueError, "requires names with one number", arranged("{v}_{u}", rows, lawnmower=True)),
        (FormatError, "give 2 x 999,999,999 views from 3 files",
         arranged("{v}_{u}", ["0_0", "0_1", "1_999999998"])),
    )  # fmt: skip


def test_a_pattern_without_row_and_column_is_refused():
    for text in ["a_{v}.png", "a_{v}_{u}_{i}.png", "a_{v}_{w}.png", "{}", "{v}{v}{u}", "a.png"]:
        with pytest.raises(ValueError, match=r"must have \{v\} and \{u\} once each, or \{i\} once"):
            Pattern(text)


def test_guesses():
    for names, pattern in [
        (grid("view_{v:02d}_{u:02d}.tif", range(2), range(3)), "view_{v}_{u}.tif"),
        ([f"input_Cam{i:03d}.png" for i in range(9)] + ["mask_1.png"], "input_Cam{i}.png"),
        (grid("out_{v:02d}_{u:02d}_-381.9_{u}.5_.png", range(2), range(2)), "out_{v}_{u}_*.png"),
        (grid("set7_{v}-{u}.jpg", range(3), range(2)), "set7_{v}-{u}.jpg"),
        ([f"frame{i}.png" for i in range(4)] + ["cover.png"], "frame{i}.png"),
        (grid("v_{v}_{u}.png", range(1), range(9)), "v_{v}_{u}.png"),
        (grid("v_{v}_{u}.png", range(9), range(4, 5)), "v_{v}_{u}.png"),
        ([f"IMG_20240131_{i:04d}.png" for i in range(9)], "IMG_20240131_{i}.png"),
    ]:
        assert guess(names).text == pattern


def test_names_that_cannot_be_guessed():
    for names, message in [
        ([f"IMG_{v + u}_{v}_{u}.png" for v in range(2) for u in range(2)],
         r"3 numbers vary .*IMG_0_0_0\.png.*give a pattern"),
        ([f"IMG_0001_{3 * u + v + 1:03d}_{u}_{v}.png" for v in range(3) for u in range(4)],
         r"perhaps pattern='IMG_0001_\{n\}_\{v\}_\{u\}\.png'"),
        ([f"t{20240131 + 7 * i}-{i}.png" for i in range(9)],
         r"perhaps pattern='t\{n\}-\{i\}\.png'"),
        (["white.png", "raw.png"], r"No number varies .* raw frame as a file"),
    ]:  # fmt: skip
        with pytest.raises(FormatError, match=message):
            guess(names)


def test_pictures_left_out_are_counted(caplog: pytest.LogCaptureFixture):
    with caplog.at_level("INFO", logger="clplen.io"):
        guess([f"IMG_{i}.png" for i in range(4)])
        assert not caplog.text
        guess([*(f"IMG_{i}.png" for i in range(4)), "cover.png", "a_b.png"], where="D")
    assert "2 of 6 pictures in D are left out" in caplog.text
    assert "do not match the guessed pattern 'IMG_{i}" in caplog.text


def test_files_of_no_kind(tmp_path: Path):
    for name, content, said in [
        ("a.npz", b"PK\3\4 and more", "archive of NumPy arrays .* save .* as .npy"),
        ("a.txt", b"hello\nworld", r"\(it is text: 'hello world'\)"),
        ("a.bin", b"\x00\xff12", r"\(it begins with the bytes 00 ff 31 32\)"),
    ]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FormatError, match=said):
            kind_of(tmp_path / name)


def test_names_that_are_no_views():
    views = ["input_Cam001.png", "unmasked_1.png", "depthcharge_2.png", "a/view_1_2.png"]
    others = ["mask_1.png", "gt_disp_lowres.png", "Depth01.png", "objectids_highres.png", ".x.png"]
    others += ["a/depth_3.png", ".hidden/view_1_2.png"]
    assert views_only(views + others) == views
    assert views_only(["depth_1_2.png", ".x"], pattern="depth_{v}_{u}.png") == ["depth_1_2.png"]


def test_numbers_that_are_no_rows():
    assert Pattern("{v}_{u}").numbers(["1" * 5000 + "_2", "3_4"]) == {(3, 4): ["3_4"]}
    long = "7" * 5000
    with pytest.raises(FormatError, match="3 numbers vary"):
        guess([f"{long}_{v}_{u}_{v + u}.png" for v in range(2) for u in range(2)])
    assert guess([f"{long}_{u}.png" for u in range(2)]).text == f"{long}_{{i}}.png"
