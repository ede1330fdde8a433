"""Arguments of ``kernels/common/builtins.cl`` and its results in float64."""

from __future__ import annotations

import numpy as np

from clplen.types import Array

COUNT = 32  # samples of each argument
TOLERANCE = 2e-5  # absolute, for values up to 11: a few units in the last place of float32
_WIDEST_ONLY = ("exp", "sincos, sine", "sincos, cosine")  # scalar and 16 wide only


def inputs() -> tuple[Array, Array, Array, Array]:
    """Return a and b in float32, then the integers of a in the dtypes of stored light fields."""
    k = np.arange(COUNT)
    x = np.array([0.3 + 0.131 * k, 2.1 - 0.1373 * ((7 * k) % COUNT)], np.float32)
    return x, x[0].astype("i").astype("f2"), x[0].astype("u1"), x[0].astype("u2")


def expected(*, double: bool) -> dict[str, Array]:
    """Return the values of every function in the order of the kernel."""
    a, b = inputs()[0].astype(float)
    i, j = a.astype(int), b.astype(int)
    real = {
        "sqrt": np.sqrt(a),
        "exp": np.exp(b),
        "sincos, sine": np.sin(a),
        "sincos, cosine": np.cos(a),
        "rint": np.rint(b),
        "floor": np.floor(b),
        "ceil": np.ceil(b),
        "fabs": np.abs(b),
        "fmin": np.minimum(a, b),
        "fmax": np.maximum(a, b),
        "clamp": np.minimum(np.maximum(b, a - 1), a),
        "mad": a * b + a,
        "fma": a * b + a,
    }
    integer = {
        "min of int": np.minimum(i, j),
        "max of int": np.maximum(i, j),
        "clamp of int": np.minimum(np.maximum(j, i - 1), i),
    }
    vector = {
        **{name: value for name, value in real.items() if name not in _WIDEST_ONLY},
        "select": np.where(i > j, b, a),
        **integer,
        **dict.fromkeys(("vload_half", "convert of uchar", "convert of ushort"), i),
    }
    named = {
        **real,
        "sin": np.sin(a),
        "cos": np.cos(a),
        "isfinite": a,
        "any": np.where((i > 2) | (j > 2), a, b),
        "abs": np.abs(j),
        **integer,
        "clz of uint": 31 - np.floor(np.log2(i + 1)),
        "clz of ulong": 63 - np.floor(np.log2(i + 1)),
        "mul_hi": i >> 1,
        "dot": a * b + b + a + 4,
        "as_float, as_uint": -a,
        "vload_half": i,
        "atomic_cmpxchg": a,
        "atomic_add": b,
        "convert_long_rte, as_ulong": np.rint(b) + 4,
        "functions of float2": np.floor(b) + np.rint(a) + np.sqrt(a) + np.clip(b, 0, 1),
    }
    for width in (4, 8, 16):
        named |= {f"{name}, {width} wide": value for name, value in vector.items()}
    named |= {f"{name}, 16 wide": real[name] for name in _WIDEST_ONLY}
    # odd samples of every 16, then even samples, negated if their bits are odd
    even, odd = np.moveaxis(a.reshape(-1, 8, 2), -1, 0)
    signed = np.where(even.astype(np.float32).view(np.uint32) & 1, -even, even)
    named["odd and even samples, 16 wide"] = np.concatenate((odd, signed), axis=1).ravel()
    if double:
        named |= {f"{name} of double": value for name, value in real.items()}
    return named


def wrong(values: Array, *, double: bool) -> list[str]:
    """Return the names of functions whose values are outside the tolerance."""
    pairs = zip(expected(double=double).items(), values, strict=True)
    return [
        name for (name, value), result in pairs if not np.abs(result - value).max() <= TOLERANCE
    ]
