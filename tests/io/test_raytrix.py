"""Calibrations of Raytrix cameras: the numbers of the file, and the lenses on the sensor."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clplen.errors import FormatError
from clplen.io import read_lightfield
from clplen.io.raw.raytrix import (
    Distortion,
    FocusType,
    RaytrixCalibration,
    lattice_vectors,
    read_raytrix,
    write_raytrix,
)

# In the order and with the units of the cameras' own files; a hexagonal array of three types.
TEXT = """<?xml version="1.0"?>
<RayCalibData version="1.0">
  <offset units="pix"><x>4.25</x><y>-1.5</y></offset>
  <diameter units="pix">11.5</diameter>
  <rotation units="rad">0.0200</rotation>
  <lens_border units="pix">1</lens_border>
  <tcp units="virtual_depth">2.11</tcp>
  <lens_base_x units="lens"><x>-1</x><y>-8.74227765735e-008</y></lens_base_x>
  <lens_base_y units="lens"><x>-0.499999910593</x><y>-0.866025447845</y></lens_base_y>
  <sub_grid_base units="lens"><x>-2.99999976158</x><y>-1.7320510149</y></sub_grid_base>
  <distortion type="radial">
    <function>Brown</function>
    <parameter count="2">-0.00145;0.000735</parameter>
    <offset units="pix"><x>3186.7</x><y>2651.1</y></offset>
  </distortion>
  <lens_type id="0">
    <offset units="lens"><x>0</x><y>0</y></offset>
    <depth_range units="virtual_depth"><min>1</min><max>3</max></depth_range>
  </lens_type>
  <lens_type id="2">
    <offset units="lens"><x>1</x><y>8.7e-008</y></offset>
    <depth_range units="virtual_depth"><min>3.8</min><max>100</max></depth_range>
  </lens_type>
  <lens_type id="1">
    <offset units="lens"><x>-1</x><y>-8.7e-008</y></offset>
    <depth_range units="virtual_depth"><min>2.8</min><max>4</max></depth_range>
  </lens_type>
</RayCalibData>
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "a.xml"
    path.write_text(TEXT)
    return path


def test_the_numbers_of_the_file(path: Path):
    found = read_raytrix(path)
    assert found.offset == (4.25, -1.5)
    assert found.diameter == 11.5
    assert found.rotation == 0.02
    assert found.lens_border == 1
    assert found.tcp == 2.11
    assert found.lens_base_x == (-1, -8.74227765735e-8)
    assert found.lens_base_y == (-0.499999910593, -0.866025447845)
    assert found.sub_grid_base == (-2.99999976158, -1.7320510149)
    assert found.distortion == Distortion("radial", "Brown", (-0.00145, 0.000735), (3186.7, 2651.1))
    assert [t.depth_range for t in found.lens_types] == [(1, 3), (2.8, 4), (3.8, 100)]
    assert [t.offset[0] for t in found.lens_types] == [0, -1, 1]


def test_the_lenses_by_hand(path: Path):
    """Lens (i, k) of the file: rotate in coordinates with y up, then turn y down."""
    found, shape = read_raytrix(path), (60, 91)
    centres = []
    for i in range(-12, 13):
        for k in range(-12, 13):
            x = i * found.lens_base_x[0] + k * found.lens_base_y[0]
            y = i * found.lens_base_x[1] + k * found.lens_base_y[1]
            c, s = math.cos(0.02), math.sin(0.02)
            up = -1.5 + 11.5 * (s * x + c * y)
            right = 4.25 + 11.5 * (c * x - s * y)
            centres.append((29.5 - up, 45 + right))
    inside = [(y, x) for y, x in centres if -0.5 <= y < 59.5 and -0.5 <= x < 90.5]
    lattice = found.lattice(shape)
    assert lattice.kind == "hexagonal"
    assert lattice.origin == (31.0, 49.25)
    assert lattice.rotation == pytest.approx(-0.02, abs=1e-6)  # clockwise is positive there
    ours = lattice.centres()
    assert len(ours) == len(inside) > 40
    # The file's base vectors are hexagonal to 1e-7 only.
    np.testing.assert_allclose(sorted(map(tuple, ours)), sorted(inside), atol=1e-4)


def test_every_lens_has_one_type(path: Path):
    found = read_raytrix(path)
    lattice, types = found.lattice((100, 100)), found.types()
    count = np.zeros(len(lattice.centres()), int)
    for kind in types:
        steps = np.array(kind.steps).T
        away = lattice.centres() - lattice.origin - kind.offset
        places = np.linalg.solve(steps, away.T)
        count += (np.abs(places - np.round(places)) < 1e-3).all(0)
    assert (count == 1).all()
    # Neighbours along a row take the types in turn.
    assert [kind.depth_range[0] for kind in types] == [1, 2.8, 3.8]
    nearest = [np.linalg.norm(kind.steps, axis=1).min() for kind in types]
    np.testing.assert_allclose(nearest, math.sqrt(3) * 11.5, rtol=1e-5)


def square(**words) -> RaytrixCalibration:
    given = {"offset": (0, 0), "diameter": 10, "lens_base_x": (1, 0), "lens_base_y": (0, 1)}
    return RaytrixCalibration(**(given | words))


def test_square_arrays_of_any_number_of_types():
    lattice = square(lens_base_y=(0, 1.02)).lattice((50, 40))
    assert (lattice.kind, lattice.row, lattice.column) == ("square", (10.2, 0), (0, 10))
    four = [FocusType((x, y), (1 + x, 3 + y)) for x in (0, 1) for y in (0, 1)]
    types = square(sub_grid_base=(2, 2), lens_types=tuple(four)).types()
    assert types[0].steps == ((-20, 0), (0, 20))
    assert types[2].offset == (0, 10)
    assert types[1].offset == (-10, 0)
    (one,) = square(lens_types=tuple(four[:1])).types()
    assert one.steps == ((-10, 0), (0, 10))
    with pytest.raises(ValueError, match=r"of each of 3 types, got 1\.33"):
        square(sub_grid_base=(2, 2), lens_types=tuple(four[:3])).types()
    with pytest.raises(ValueError, match="one or two lenses of each of 4 types"):
        square(sub_grid_base=(2.5, 1.6), lens_types=tuple(four)).types()


def test_any_base_vectors_give_the_same_lattice():
    """Skew bases of one lattice: the vectors returned span it, with rows down, columns right."""
    for angle, degrees in itertools.product((60, 90, 120), (0, 7, -14, 30, 133)):
        turn = np.radians([degrees, degrees + angle])
        a, b = 9 * np.stack([np.sin(turn), np.cos(turn)], 1)
        for first, second in ((a, b), (b, -a), (2 * a + b, a + b), (-a, b + 3 * a)):
            kind, row, column = lattice_vectors(tuple(first), tuple(second))
            assert kind == ("square" if angle == 90 else "hexagonal")
            assert min(row[0], column[1]) > 0
            across, along = sorted((row, column), key=lambda step: math.hypot(*step))
            if math.hypot(*column) == math.hypot(*row):
                across, along = row, column
            half = np.array(across) + (0 if angle == 90 else np.array(along) / 2)
            whole = np.linalg.solve(np.array([a, b]).T, np.array([along, half]).T)
            np.testing.assert_allclose(whole, np.round(whole), atol=1e-9)
            assert abs(np.linalg.det(whole)) == pytest.approx(1)


def test_oblique_lattices_are_refused():
    for words, message in (
        ({"lens_base_y": (0.3, 1)}, "must be square or hexagonal"),
        ({"lens_base_y": (2, 0)}, "must span a lattice"),
        ({"lens_base_y": (0, 1e300)}, "must span a lattice"),
        ({"diameter": 0}, "1 to 10000 pixels, got 0"),
    ):
        with pytest.raises(ValueError, match=message):
            square(**words).lattice((50, 50))


def test_written_and_read_again(path: Path, tmp_path: Path):
    found = read_raytrix(path)
    write_raytrix(tmp_path / "b.xml", found)
    assert read_raytrix(tmp_path / "b.xml") == found
    odd = replace(found, tcp=None, distortion=Distortion('a"<&', "f<", (), (0, 0)), lens_types=())
    write_raytrix(tmp_path / "b.xml", odd)
    assert read_raytrix(tmp_path / "b.xml") == odd
    write_raytrix(tmp_path / "c.xml", square())
    assert read_raytrix(tmp_path / "c.xml") == square()
    with pytest.raises(ValueError, match=r"must end in \.xml .* got .*b\.txt"):
        write_raytrix(tmp_path / "b.txt", found)


def test_utf16_is_read(path: Path):
    path.write_bytes(TEXT.replace('"1.0"?', '"1.0" encoding="utf-16"?').encode("utf-16"))
    assert read_raytrix(path).diameter == 11.5


def test_damaged_files_say_where(path: Path):
    for old, new, match in [
        ("<RayCalibData", "<!DOCTYPE a [<!ENTITY b 'c'>]><RayCalibData", "declares a document"),
        ("RayCalibData", "Calib", r"must have the root <RayCalibData>, got <Calib>"),
        ('Data version="1.0"', 'Data version="2.0"', r"version 1\.0, got '2\.0'"),
        ("</tcp>", "", "is not valid XML"),
        (">11.5<", ">eleven<", "<diameter> must be a finite number, got 'eleven'"),
        (">11.5<", ">nan<", "<diameter> must be a finite number, got 'nan'"),
        (">11.5<", ">0<", "diameter must be 1 to 10000 pixels"),
        ('units="rad"', 'units="deg"', "<rotation> must be in 'rad', got 'deg'"),
        ("<diameter", "<diameter units='pix'>2</diameter><diameter", "one element <dia.*, got 2"),
        ("<y>-0.866025447845</y>", "", "<lens_base_y> must have one element <y>, got 0"),
        ('id="2"', 'id="1"', r"ids .* must be 0, 1, .* got \[0, 1, 1\]"),
        ('id="2"', 'id="two"', "must be a number, got 'two'"),
    ]:
        path.write_text(TEXT.replace(old, new))
        with pytest.raises(FormatError, match=rf"a\.xml.*{match}"):
            read_raytrix(path)


def test_files_that_are_none(tmp_path: Path):
    path = tmp_path / "a.xml"
    for content, message in (
        (None, "There is no file"),
        (b"\xff\xfe\x00", "neither UTF-8 nor UTF-16"),
        (b" " * (2 << 20), r"longer than 1,048,576 bytes"),
        (b"<a>" * 100000, "is not valid XML"),  # deep, not long
    ):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(FormatError, match=message):
            read_raytrix(path)


def test_light_fields_are_rendered_not_sliced(path: Path, tmp_path: Path):
    with pytest.raises(FormatError, match=r"focused \(plenoptic 2\.0\).*read_raw"):
        read_lightfield(path)
    closed = tmp_path / "a.ray"
    closed.write_bytes(b"anything")
    for read in (read_lightfield, read_raytrix):
        with pytest.raises(FormatError, match=r"proprietary format.*give the \.xml"):
            read(closed)
