"""Values of ``kernels/common/builtins.cl`` in double precision, by the standard library alone.

A child process, in which an unfit compiler may die, compares with them; it starts in the time
that NumPy takes to be imported.
"""

from __future__ import annotations

import math
import struct
from array import array
from collections.abc import Callable

COUNT = 32  # samples of each argument
TOLERANCE = 2e-5  # of values up to 11: some units in the last place of float32, as OpenCL allows

Function = Callable[[float, float], float]

_REAL: dict[str, Function] = {
    "sqrt": lambda a, b: math.sqrt(a),
    "exp": lambda a, b: math.exp(b),
    "sincos, sine": lambda a, b: math.sin(a),
    "sincos, cosine": lambda a, b: math.cos(a),
    "rint": lambda a, b: round(b),
    "floor": lambda a, b: math.floor(b),
    "ceil": lambda a, b: math.ceil(b),
    "fabs": lambda a, b: abs(b),
    "fmin": lambda a, b: min(a, b),
    "fmax": lambda a, b: max(a, b),
    "clamp": lambda a, b: min(max(b, a - 1), a),
    "mad": lambda a, b: a * b + a,
    "fma": lambda a, b: a * b + a,
}
_INTEGER: dict[str, Function] = {
    "min of int": lambda a, b: min(int(a), int(b)),
    "max of int": lambda a, b: max(int(a), int(b)),
    "clamp of int": lambda a, b: min(max(int(b), int(a) - 1), int(a)),
}
_SCALAR: dict[str, Function] = {
    "sin": lambda a, b: math.sin(a),
    "cos": lambda a, b: math.cos(a),
    "isfinite": lambda a, b: a,
    "any": lambda a, b: a if int(a) > 2 or int(b) > 2 else b,
    "abs": lambda a, b: abs(int(b)),
    **_INTEGER,
    "clz of uint": lambda a, b: 32 - (int(a) + 1).bit_length(),
    "clz of ulong": lambda a, b: 64 - (int(a) + 1).bit_length(),
    "mul_hi": lambda a, b: int(a) >> 1,
    "dot": lambda a, b: a * b + b + a + 4,
    "as_float, as_uint": lambda a, b: -a,
    "vload_half": lambda a, b: int(a),
    "atomic_cmpxchg": lambda a, b: a,
    "functions of float2": lambda a, b: (
        math.floor(b) + round(a) + math.sqrt(a) + min(max(b, 0.0), 1.0)
    ),
}
_WIDEST_ONLY = ("exp", "sincos, sine", "sincos, cosine")  # not 4 and 8 samples at a time
_VECTOR: dict[str, Function] = {
    **{name: function for name, function in _REAL.items() if name not in _WIDEST_ONLY},
    "select": lambda a, b: b if int(a) > int(b) else a,
    **_INTEGER,
    "vload_half": lambda a, b: int(a),
    "convert of uchar": lambda a, b: int(a),
    "convert of ushort": lambda a, b: int(a),
}


def inputs() -> tuple[array[float], bytes, bytes, bytes]:
    """Arguments of the kernel: a and b as floats, then the integers of a as stored samples."""
    a = [0.3 + 0.131 * k for k in range(COUNT)]
    b = [2.1 - 0.1373 * ((7 * k) % COUNT) for k in range(COUNT)]
    whole = [int(value) for value in a]
    return (
        array("f", a + b),
        struct.pack(f"{COUNT}e", *whole),
        bytes(whole),
        struct.pack(f"{COUNT}H", *whole),
    )


def expected(*, double: bool) -> dict[str, list[float]]:
    """What the kernel has to give, in its order."""
    x = inputs()[0]
    pairs = list(zip(x[:COUNT], x[COUNT:], strict=True))
    named = {**_REAL, **_SCALAR}
    for width in (4, 8, 16):
        named |= {f"{name}, {width} wide": function for name, function in _VECTOR.items()}
    named |= {f"{name}, 16 wide": _REAL[name] for name in _WIDEST_ONLY}
    values = {name: [function(a, b) for a, b in pairs] for name, function in named.items()}
    values["odd and even samples, 16 wide"] = _shuffled([a for a, _ in pairs])
    if double:
        values |= {
            f"{name} of double": [function(a, b) for a, b in pairs]
            for name, function in _REAL.items()
        }
    return values


def _shuffled(values: list[float]) -> list[float]:
    """Of every 16 samples the odd ones, then the even ones, their sign changed if odd in bits."""
    moved = []
    for start in range(0, len(values), 16):
        some = values[start : start + 16]
        bits = [struct.unpack("I", struct.pack("f", value))[0] for value in some]
        signed = [-v if low & 1 else v for v, low in zip(some, bits, strict=True)]
        moved += some[1::2] + signed[::2]
    return moved


def wrong(values: array[float], *, double: bool) -> list[str]:
    """Names of the functions whose values differ from those expected."""
    found = []
    for number, (name, wanted) in enumerate(expected(double=double).items()):
        got = values[number * COUNT : (number + 1) * COUNT]
        if not all(abs(g - w) <= TOLERANCE for g, w in zip(got, wanted, strict=True)):
            found.append(name)
    return found
