"""Kernel files keep the rules, and the table of kernels/README.md describes them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from launches import FOLDER, SOURCES, code, complaints, declared, fits, opening

from clplen.compute.device import Device

TESTS = Path(__file__).parent
KERNELS = {(file, name) for file in SOURCES for name in declared(file)}

POINT = r"(?<![\w.])(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?(?!\w)"
EXPONENT = r"(?<![\w.])\d+[eE][+-]?\d+(?!\w)"
CONSTANT = r"\bM_(?:\w(?!_F\b))+\b(?<!_F)"
DOUBLE_LITERAL = re.compile(f"{POINT}|{EXPONENT}|{CONSTANT}")
DOUBLE_BRANCH = re.compile(r"#ifdef DOUBLE\n.*?#(?:else|endif)", re.DOTALL)


# What tests/conftest.py compares at every launch of every test


def test_a_wrong_argument_is_found(device: Device) -> None:
    single, double = {}, {"DOUBLE": True}
    for kind, right, defines in (
        ("float", np.float32(1), single),
        ("real", np.float64(1), double),
        ("long", np.int64(1), single),
        ("real2", np.zeros(2, np.float32), single),
        ("cplx", np.complex64(1), single),
        ("float*", device.zeros((3, 2), np.float32), single),
        ("real2*", device.zeros((3, 2), np.float32), single),
        ("cplx*", device.zeros((3, 2), np.complex64), single),
        ("SAMPLE*", device.zeros((3, 2), np.uint8), {"SAMPLE": "uchar"}),
        ("local float*", cl.LocalMemory(4), single),
    ):
        assert fits(kind, right, defines)
        for wrong in (1, 1.0, np.uint32(1), np.zeros(3, np.float32), np.complex128(1)):
            assert not fits(kind, wrong, defines)
    pairs, field = device.zeros((3, 2), np.float32), device.zeros((3, 2), np.complex64)
    for kind, wrong in (("float4*", pairs), ("int*", pairs), ("float", pairs), ("float*", field)):
        assert not fits(kind, wrong, single)
    assert not fits("cplx*", field, double)


def test_a_wrong_launch_is_found(device: Device) -> None:
    out, u = device.zeros((3, 5), np.float32), device.zeros((3, 5), np.complex64)
    sizes = (np.int32(3), np.int32(5))

    def judged(*args: Any, **defines: Any) -> list[str]:
        return list(complaints("intensity.cl", "intensity", args, defines))

    assert judged(out, u, *sizes) == []
    assert judged(u, *sizes) == ["intensity takes 4 arguments, not 3"]
    assert len(judged(u, out, *sizes)) == 2
    assert judged(out, u, np.int64(3), sizes[1]) == [
        "intensity declares int ny and is given int64 int64()"
    ]
    assert judged(out, u, *sizes, LANES=4) == ["intensity.cl does not describe -DLANES"]


# What the files say


def test_double_literals_are_found() -> None:
    for literal in ("1.0", "1.", ".5", "2.5e-3", "1e5", "3E+2", "M_PI", "M_SQRT2"):
        for text in (f"x = {literal};", f"f({literal}, 1)", f"a*{literal}+b"):
            assert DOUBLE_LITERAL.findall(text) == [literal]
    for text in ("1.0f", ".5f", "1e5f", "M_PI_F", "v.s0", "a[1].x", "float4 x1e5", "0x1e5", "3"):
        assert DOUBLE_LITERAL.findall(f"y = {text};") == []


def shortcomings(file: str, tests: str) -> Iterator[str]:
    """Yield what a kernel file lacks, given the text of the tests of kernels."""
    comment, text, kernels = opening(SOURCES[file]), code(SOURCES[file]), declared(file)
    for literal in DOUBLE_LITERAL.findall(DOUBLE_BRANCH.sub(" ", text)):
        yield f"double literal {literal}"
    for word in re.findall(r"\bnative_\w+|\bhalf_\w+\(|fast-relaxed-math", text):
        yield f"inaccurate arithmetic {word}"
    if len(comment.splitlines()) < 3:
        yield "no comment that says what it computes"
    if kernels and "=" not in comment:
        yield "no equation"
    if kernels and not re.search(r"FOR_X|\bitem\b", comment):
        yield "no mapping of work-items"
    switches = set(re.findall(r"#\s*(?:ifdef|ifndef)\s+(\w+)|defined\((\w+)\)", text))
    for switch in {name for pair in switches for name in pair if name}:
        if not switch.startswith("CLPLEN_") and f"-D{switch}" not in comment:
            yield f"no description of -D{switch}"
    if kernels and re.search(r"\b(?:real|cplx)\b", text) and "-DDOUBLE" not in comment:
        yield "no description of -DDOUBLE"
    included = any(f'#include "{file}"' in source for source in SOURCES.values())
    if file not in tests and (kernels or not included):
        yield "no test in tests/kernels"


def test_kernel_files_keep_the_rules() -> None:
    tests = "".join(test.read_text() for test in TESTS.glob("kernels/test_*.py"))
    assert [f"{file}: {words}" for file in SOURCES for words in shortcomings(file, tests)] == []


def test_a_planted_fault_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    source = "kernel void one(global float *x) { x[0] = native_sin(1.0); }\n#ifdef TWO\n#endif\n"
    monkeypatch.setitem(SOURCES, "planted.cl", source)
    assert list(shortcomings("planted.cl", "")) == [
        "double literal 1.0",
        "inaccurate arithmetic native_sin",
        "no comment that says what it computes",
        "no equation",
        "no mapping of work-items",
        "no description of -DTWO",
        "no test in tests/kernels",
    ]


# The table


def rows() -> list[list[str]]:
    """Cells of the table in kernels/README.md, below its head."""
    lines = (FOLDER / "README.md").read_text().splitlines()
    table = [line for line in lines if line.startswith("| `")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table]


def ticked(cell: str) -> list[str]:
    """What stands between backticks."""
    return re.findall(r"`([^`]+)`", cell)


def test_the_table_has_a_row_for_every_kernel_and_every_header() -> None:
    listed = [(ticked(row[0])[0], *ticked(row[1])) for row in rows()]
    headers = {(file,) for file in SOURCES if not declared(file)}
    assert sorted(listed) == sorted(KERNELS | headers)
    assert {len(row) for row in rows()} == {4}


def test_the_table_names_tests_that_exist() -> None:
    for file, kernel, _, tests in rows():
        assert ticked(tests), file
        for name in ticked(tests):
            assert (TESTS / "kernels" / name).is_file(), name
            assert ticked(file)[0] in (TESTS / "kernels" / name).read_text() or not ticked(kernel)
