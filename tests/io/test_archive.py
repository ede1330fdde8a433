"""Zip archives of views: names, damage, and members that are not what they say."""

from __future__ import annotations

import io
import logging
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import tifffile
from png_writer import encode

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield
from clplen.io.formats import picture
from clplen.io.lightfields.lightfield_files import files_of

SHAPE = (3, 4, 5, 7)


def samples() -> np.ndarray:
    return np.random.default_rng(6).integers(1, 250, (*SHAPE, 3)).astype(np.uint8)


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., Path]:
    """make(name of (v, u), others, how) writes a.zip with samples()."""

    def write(name: str, others: dict[str, bytes] | None = None, how: int = 8) -> Path:
        path = tmp_path / "a.zip"
        with zipfile.ZipFile(path, "w", how) as archive:
            for v, u in np.ndindex(*SHAPE[:2]):
                archive.writestr(name.format(v=v, u=u, i=4 * v + u), encode(samples()[v, u]))
            for other, content in (others or {}).items():
                archive.writestr(other, content)
        return path

    return write


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("scene/rectified/out_{v:02d}_{u:02d}_-1.5_2.5_.png", zipfile.ZIP_STORED),
        ("scene\\p{v}-{u}.png", zipfile.ZIP_DEFLATED),
        ("set/row{v}/{u}.png", zipfile.ZIP_DEFLATED),
    ],
)
def test_views_anywhere(make: Callable[..., Path], device: Device, name: str, how: int):
    path = make(name, {"readme.txt": b"hello", "__MACOSX/x/._view_00_00.png": b"no"}, how)
    lf = read_lightfield(path, device=device)
    assert lf.dtype == np.uint8
    np.testing.assert_array_equal(lf.to_numpy(), samples())


def test_words_of_layout(
    make: Callable[..., Path], device: Device, caplog: pytest.LogCaptureFixture
):
    path = make("s/c{i:03d}.png", {"s/mask_1.png": b"no picture"})
    with caplog.at_level(logging.INFO, "clplen.io"):
        lf = read_lightfield(path, device=device, views=(3, 4), swap_uv=True, flip_v=True)
    np.testing.assert_array_equal(lf.to_numpy(), samples().swapaxes(0, 1)[::-1])
    assert f"of 5 x 7 x 3 uint8 from {path / 's'}, pattern 'c{{i}}.png' (guessed" in caplog.text
    assert files_of(path) == [path]
    half = read_lightfield(path, device=device, pattern="c00{i}.png", views=(2, 5))
    np.testing.assert_array_equal(half.to_numpy()[1, 2], samples()[1, 3])


def test_members_that_are_refused_by_name(make: Callable[..., Path], device: Device):
    for name, said in (
        ("../x.png", "is outside"),
        ("/etc/x.png", "is outside"),
        ("C:\\x.png", "is outside"),
        ("a/../../x.png", "is outside"),
        ("./view_0_0.png", "occurs twice"),
    ):
        path = make("view_{v}_{u}.png", {name: b"x"})
        with pytest.raises(FormatError, match=rf"a\.zip: the member '.*\.png' {said}"):
            read_lightfield(path, device=device)


def test_missing_and_unusable_views(make: Callable[..., Path], device: Device):
    path = make("s/view_{v}_{u}.png", {"s/view_4_0.png": b"x"})
    with pytest.raises(FormatError, match=r"7 of 5 x 4 views are missing in .*\(v=3, u=0\)"):
        read_lightfield(path, device=device)
    with pytest.raises(
        FormatError, match=r"1 of 13 views in .*a\.zip/s cannot be used: view_4_0\.png is unr"
    ):
        read_lightfield(path, device=device, allow_missing=True)
    with pytest.raises(FormatError, match=r"No file in .*a\.zip matches .*view_0_0\.png"):
        read_lightfield(path, device=device, pattern="cam{v}_{u}.png")


def changed(path: Path, offset: int, value: bytes) -> None:
    """Other bytes in the entry of the first member, in its own and in the central header."""
    content = bytearray(path.read_bytes())
    for mark, shift in ((b"PK\3\4", 0), (b"PK\1\2", 2)):
        start = content.index(mark) + 4 + shift + offset
        content[start : start + len(value)] = value
    path.write_bytes(bytes(content))


FLAGS, METHOD, CRC, SIZE = 2, 4, 10, 18  # from the version on


def test_members_that_are_not_what_they_say(make: Callable[..., Path], device: Device):
    for offset, value, said in [
        (FLAGS, b"\1\0", r"view_0_0\.png is encrypted: create an archive without"),
        (METHOD, b"\x0c\0", r"view_0_0\.png is compressed with method 12: write the archive"),
        (CRC, b"abcd", r"view_0_0\.png is unreadable \(Bad CRC-32"),
        (SIZE, struct.pack("<I", 2**31), r"view_0_0\.png declares 2,147,483,648 bytes, more"),
        (SIZE, struct.pack("<I", 50), r"view_0_0\.png is unreadable \(Bad CRC-32"),
        (SIZE, struct.pack("<I", 1000), r"view_0_0\.png has a different size than its archive"),
    ]:
        path = make("view_{v}_{u}.png")
        changed(path, offset, value)
        with pytest.raises(FormatError, match=f"1 of 12 views .*{said}"):
            read_lightfield(path, device=device)


def test_a_bomb_is_read_up_to_its_declared_size(make: Callable[..., Path], device: Device):
    path = make("view_{v}_{u}.png", {"view_3_0.png": bytes(40 << 20)})
    content = bytearray(path.read_bytes())
    for mark, shift in ((b"PK\3\4", 0), (b"PK\1\2", 2)):
        start = content.rindex(mark) + 4 + shift + SIZE
        content[start : start + 4] = struct.pack("<I", 500)
    path.write_bytes(bytes(content))
    tracemalloc.start()
    with pytest.raises(FormatError, match=r"view_3_0\.png is unreadable \(Bad CRC-32"):
        read_lightfield(path, device=device, allow_missing=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 << 20


@pytest.mark.parametrize("kind", ["png", "tif"])
def test_a_member_with_a_long_hole(
    make: Callable[..., Path], device: Device, monkeypatch: pytest.MonkeyPatch, kind: str
):
    monkeypatch.setattr(picture, "LARGE", 1 << 20)
    content = io.BytesIO(encode(samples()[0, 0]))
    if kind == "tif":
        tifffile.imwrite(content, samples()[0, 0])
    path = make("view_{v}_{u}.png", {"view_3_0.png": content.getvalue() + bytes(32 << 20)})
    refused = pytest.raises(FormatError, match=r"view_3_0\.png has 33,\d+,\d+ bytes, far more")
    tracemalloc.start()
    with refused if kind == "png" else nullcontext():
        lf = read_lightfield(path, device=device, allow_missing=True)
        np.testing.assert_array_equal(lf.to_numpy()[3, 0], samples()[0, 0])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 << 20


def test_truncated_archives(make: Callable[..., Path], device: Device):
    path = make("view_{v}_{u}.png")
    whole = path.read_bytes()
    for kept in (4, 30, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:kept])
        with pytest.raises(FormatError, match=r"a\.zip is not a readable zip archive"):
            read_lightfield(path, device=device)


def test_names_without_suffix_need_a_pattern(make: Callable[..., Path], device: Device):
    path = make("view_{v}_{u}")
    lf = read_lightfield(path, device=device, pattern="view_{v}_{u}")
    np.testing.assert_array_equal(lf.to_numpy(), samples())
    with pytest.raises(FormatError, match=r"There is no picture in .*a\.zip"):
        read_lightfield(path, device=device)
