"""Patterns of file names: what is matched, ranked, missing and guessed."""

from __future__ import annotations

from pathlib import Path

import pytest

from clplen.errors import FormatError
from clplen.io.lightfields.lightfield_files import kind_of
from clplen.io.lightfields.view_names import Pattern, arrange, guess, views_only


def grid(template: str, vs: range, us: range) -> list[str]:
    return [template.format(v=v, u=u) for v in vs for u in us]


def test_first_number_and_step_do_not_matter():
    names = grid("a_{v:03d}_{u}.png", range(3, 12, 4), range(10, 40, 5))
    shape, files = arrange(Pattern("a_{v}_{u}.png"), names)
    assert shape == (3, 6)
    assert files[2, 1] == "a_011_15.png"


def test_a_counter_and_anything_are_ignored():
    names = ["x9_07_02_01.png", "y10_08_02_02.png", "thumbs.db"]
    shape, files = arrange(Pattern("*_{n}_{u}_{v}.png"), names)
    assert shape == (2, 1)
    assert files == {(0, 0): "x9_07_02_01.png", (1, 0): "y10_08_02_02.png"}


def test_a_pattern_without_row_and_column_is_refused():
    for text in ["a_{v}.png", "a_{v}_{u}_{i}.png", "a_{v}_{w}.png", "{}", "{v}{v}{u}", "a.png"]:
        with pytest.raises(ValueError, match=r"must have \{v\} and \{u\} once each, or \{i\} once"):
            Pattern(text)


def test_rows_are_counted_by_columns_where_v_differs_from_u():
    names = [f"cam{i:03d}.png" for i in range(6)]
    shape, files = arrange(Pattern("cam{i}.png"), names, views=(2, 3))
    assert shape == (2, 3)
    assert files[1, 0] == "cam003.png"


def test_a_square_count_is_taken_as_square():
    shape, files = arrange(Pattern("{i}.png"), [f"{i}.png" for i in range(1, 10)])
    assert shape == (3, 3)
    assert files[2, 2] == "9.png"


def test_a_count_that_is_no_square_asks_for_views():
    with pytest.raises(FormatError, match=r"gives 6 views, which is no square.*views=\(V, U\)"):
        arrange(Pattern("{i}.png"), [f"{i}.png" for i in range(6)])


def test_more_views_than_asked_for():
    with pytest.raises(FormatError, match=r"gives 6 views, more than views=\(1, 5\)"):
        arrange(Pattern("{i}.png"), [f"{i}.png" for i in range(6)], views=(1, 5))


def test_a_row_that_is_missing_leaves_a_gap():
    names = grid("{v}_{u}", range(2), range(2)) + grid("{v}_{u}", range(3, 4), range(2))
    shape, files = arrange(Pattern("{v}_{u}"), names)
    assert shape == (4, 2)
    assert (2, 0) not in files
    assert files[3, 1] == "3_1"


def test_counts_that_contradict_views():
    with pytest.raises(FormatError, match=r"give 2 x 3 views .* but views=\(3, 2\)"):
        arrange(Pattern("{v}_{u}"), grid("{v}_{u}", range(2), range(3)), views=(3, 2))


def test_two_files_for_one_view():
    with pytest.raises(FormatError, match=r"same view: 1_2\.png and 01_2\.png"):
        arrange(Pattern("{v}_{u}.png"), ["1_2.png", "01_2.png"])


def test_nothing_matches():
    with pytest.raises(FormatError, match=r"No file in D matches .*'\{v\}x\{u\}'.*a, b, c"):
        arrange(Pattern("{v}x{u}"), ["b", "a", "c", "d"], where="D")


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


def test_a_counter_beside_row_and_column_cannot_be_guessed():
    names = [f"IMG_{v + u}_{v}_{u}.png" for v in range(2) for u in range(2)]
    with pytest.raises(FormatError, match=r"3 numbers vary .*IMG_0_0_0\.png.*give a pattern"):
        guess(names)


def test_a_pattern_is_proposed():
    names = [f"IMG_0001_{3 * u + v + 1:03d}_{u}_{v}.png" for v in range(3) for u in range(4)]
    with pytest.raises(FormatError, match=r"perhaps pattern='IMG_0001_\{n\}_\{v\}_\{u\}\.png'"):
        guess(names)
    names = [f"t{20240131 + 7 * i}-{i}.png" for i in range(9)]
    with pytest.raises(FormatError, match=r"perhaps pattern='t\{n\}-\{i\}\.png'"):
        guess(names)


def test_pictures_that_are_no_views():
    for names in [["raw7.png"], ["white.png", "raw.png"]]:
        with pytest.raises(FormatError, match=r"No number varies .* raw frame as a file"):
            guess(names)


def test_pictures_left_out_are_counted(caplog: pytest.LogCaptureFixture):
    with caplog.at_level("INFO", logger="clplen.io"):
        guess([f"IMG_{i}.png" for i in range(4)])
        assert not caplog.text
        guess([*(f"IMG_{i}.png" for i in range(4)), "cover.png", "a_b.png"], where="D")
    assert "2 of 6 pictures in D are left out: they do not fit the pattern 'IMG_{i}" in caplog.text


def test_files_of_no_kind(tmp_path: Path):
    for name, content, said in [
        ("a.npz", b"PK\3\4 and more", "archive of NumPy arrays .* save .* as .npy"),
        ("a.txt", b"hello\nworld", r"\(it is text: 'hello world'\)"),
        ("a.bin", b"\x00\xff12", r"\(it begins with the bytes 00 ff 31 32\)"),
    ]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FormatError, match=said):
            kind_of(tmp_path / name)


def test_every_other_row_is_counted_backwards():
    names = [f"{i}.png" for i in range(1, 7)]
    _, files = arrange(Pattern("{i}.png"), names, views=(2, 3), lawnmower=True)
    rows = [[files[v, u] for u in range(3)] for v in range(2)]
    assert rows == [["1.png", "2.png", "3.png"], ["6.png", "5.png", "4.png"]]
    with pytest.raises(ValueError, match="lawnmower' is for names with one number"):
        arrange(Pattern("{v}_{u}"), grid("{v}_{u}", range(2), range(3)), lawnmower=True)


def test_names_that_are_no_views():
    views = ["input_Cam001.png", "unmasked_1.png", "depthcharge_2.png", "a/view_1_2.png"]
    others = ["mask_1.png", "gt_disp_lowres.png", "Depth01.png", "objectids_highres.png", ".x.png"]
    others += ["a/depth_3.png", ".hidden/view_1_2.png"]
    assert views_only(views + others) == views
    assert views_only(["depth_1_2.png", ".x"], pattern="depth_{v}_{u}.png") == ["depth_1_2.png"]


def test_numbers_that_are_no_rows():
    with pytest.raises(FormatError, match=r"would give 2 x 999,999,999 views from 3 files"):
        arrange(Pattern("{v}_{u}"), ["0_0", "0_1", "1_999999998"])
    assert Pattern("{v}_{u}").numbers(["1" * 5000 + "_2", "3_4"]) == {(3, 4): ["3_4"]}
    with pytest.raises(FormatError, match="3 numbers vary"):
        guess([f"{'7' * 5000}_{v}_{u}_{v + u}.png" for v in range(2) for u in range(2)])
    long = "7" * 5000
    assert guess([f"{long}_{u}.png" for u in range(2)]).text == f"{long}_{{i}}.png"
