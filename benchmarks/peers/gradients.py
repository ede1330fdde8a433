"""Propagation and its gradient beside torchoptics, chromatix and PyTorch by hand, in one run.

python -m benchmarks peers/gradients [--device pocl] [--size 1024] [--repeats 7] [--quick]

The band-limited angular spectrum in a window of 2N x 2N, complex64: forward alone, and forward with
the gradient of sum w abs(u)^2 by the samples of the input field. Peers that are not installed are
left out, with a note. Everybody who can keep the transfer function between calls does so.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.script import command
from clplen import Device, Field, Propagator
from clplen.bench import (
    Benchmark,
    Case,
    Report,
    finished,
    in_turn,
    numbers,
    speckle,
    time_rows,
)
from clplen.wave import intensity_gradient

Array = np.ndarray[Any, Any]
# So near that all that the pixels carry is inside the band: torchoptics has no limit of the band.
FARTHEST, WINDOWS = 0.1, 15.0  # metres, widths of the field


@dataclass(frozen=True)
class Way:
    """One way to the field and to the gradient.

    Attributes
    ----------
    name : str
    forward, both : callable
        The field; the gradient of the loss after the field.
    to_numpy : callable
        Either of them on the host, as dL/dRe u + i dL/dIm u.
    tape : int
        Bytes that are kept between forward and backward.
    """

    name: str
    forward: Callable[[], Any]
    both: Callable[[], Any]
    to_numpy: Callable[[Any], Array]
    tape: int


def directly(field: Field, weights: Array) -> Way:
    """Propagator, intensity, adjoint."""
    plan = plan_of(field)
    seen = field.intensity()
    seen.data.set(weights)

    def both() -> Field:
        u = plan(field)
        light = field.device.download(u.intensity().data)
        np.vdot(weights, light)  # the loss
        return plan.adjoint(intensity_gradient(u, seen))

    return Way("clplen", lambda: plan(field), both, Field.to_numpy, field.data.nbytes)


def distance(field: Field) -> float:
    """In metres."""
    return min(FARTHEST, WINDOWS * field.grid.extent[1])


def plan_of(field: Field) -> Propagator:
    """The band-limited angular spectrum in a window twice as wide."""
    z, device = distance(field), field.device
    return Propagator(field.grid, z, wavelength=field.wavelength, method="blas", device=device)


def of_torch(name: str, step: Callable[[Any], Any], u: Array, weights: Array) -> Way:
    """A step between tensors, with the gradient by PyTorch."""
    import torch

    w = torch.from_numpy(weights)
    plain = torch.from_numpy(u)
    given = plain.clone().requires_grad_()

    def forward() -> Any:
        with torch.no_grad():
            return step(plain)

    def loss() -> Any:
        out = step(given)
        return torch.sum(w * (out * out.conj()).real)

    def both() -> Any:
        (gradient,) = torch.autograd.grad(loss(), given)
        return gradient

    kept: dict[int, int] = {}

    def keep(x: Any) -> Any:
        kept[x.untyped_storage().data_ptr()] = x.untyped_storage().nbytes()
        return x

    with torch.autograd.graph.saved_tensors_hooks(keep, lambda x: x):
        _held = loss()
    return Way(name, forward, both, lambda x: x.detach().numpy(), sum(kept.values()))


def through_torch(field: Field, weights: Array) -> Way:
    """The same plan as a function of tensors."""
    import clplen.torch

    plan = plan_of(field)
    step = lambda u: clplen.torch.apply(plan, u)  # noqa: E731
    return of_torch("clplen.torch.apply", step, field.to_numpy(), weights)


def by_hand(field: Field, weights: Array) -> Way:
    """fft2 of the padded field, the transfer function, ifft2, the corner.

    The norm is in the factor: ifft2 of 2048 x 2048 samples divides twice by their number where
    PyTorch uses MKL (https://github.com/pytorch/pytorch/issues/169670).
    """
    import torch

    ny, nx = field.grid.shape
    factor = torch.from_numpy((transfer(field) / (4 * ny * nx)).astype(np.complex64))

    def step(u: Any) -> Any:
        spectrum = torch.fft.fft2(u, s=(2 * ny, 2 * nx))
        return torch.fft.ifft2(spectrum * factor, norm="forward")[:ny, :nx]

    return of_torch("PyTorch by hand, H kept", step, field.to_numpy(), weights)


def by_torchoptics(field: Field, weights: Array) -> Way:
    """Its Field, which makes the transfer function in every call."""
    import torch
    import torchoptics

    torchoptics.set_default_dtype(torch.float32)
    pad = [n // 2 for n in field.grid.shape]

    def step(u: Any) -> Any:
        start = torchoptics.Field(u, wavelength=field.wavelength, spacing=field.grid.pitch)
        found = start.propagate_to_z(distance(field), propagation_method="ASM", asm_pad=pad)
        return found.data

    return of_torch("torchoptics", step, field.to_numpy(), weights)


def by_chromatix(field: Field, weights: Array) -> Way:
    """Its Propagate, band-limited, with the kernel kept, compiled by `jit`."""
    import jax
    import jax.numpy as jnp
    from chromatix import ScalarField
    from chromatix.elements import Propagate

    u, w = jnp.asarray(field.to_numpy()), jnp.asarray(weights)

    def made(values: Any) -> Any:
        return ScalarField.build(values, field.grid.pitch[0], field.wavelength)

    pad = field.grid.shape[0] // 2
    element = Propagate(made(u), distance(field), 1.0, pad, bandlimit=True)
    kernel = element.propagator

    def step(kernel: Any, values: Any) -> Any:
        import equinox

        kept = equinox.tree_at(lambda e: e.propagator, element, kernel)
        return kept(made(values)).u

    def loss(values: Any, kernel: Any) -> Any:
        out = step(kernel, values)
        return jnp.sum(w * (out.real**2 + out.imag**2))

    forward, both = jax.jit(step), jax.jit(jax.value_and_grad(loss))
    _, pullback = jax.vjp(lambda values: loss(values, kernel), u)
    tape = {id(x): x.nbytes for x in jax.tree_util.tree_leaves(pullback) if hasattr(x, "nbytes")}
    return Way(
        "chromatix, jit, H kept",
        lambda: forward(kernel, u).block_until_ready(),
        lambda: both(u, kernel)[1].conj().block_until_ready(),
        np.asarray,
        sum(tape.values()),
    )


def transfer(field: Field) -> Array:
    """H within the band that the window samples, without the carrier; complex128."""
    z, lam, axes = distance(field), field.wavelength, []
    for n, pitch in zip(field.grid.shape, field.grid.pitch, strict=True):
        f = np.fft.fftfreq(2 * n, pitch)
        limit = 1 / (lam * np.hypot(z / (n * pitch), 1))
        axes.append((f, np.abs(f) <= limit))
    (fy, in_y), (fx, in_x) = axes
    s = lam**2 * np.add.outer(fy**2, fx**2)
    turns = -z / lam * s / (1 + np.sqrt(np.maximum(1 - s, 0)))
    return np.exp(2j * np.pi * turns) * np.logical_and.outer(in_y, in_x)


def in_double(field: Field, weights: Array) -> tuple[Array, Array]:
    """Field and gradient by NumPy in double precision."""
    (ny, nx), h = field.grid.shape, transfer(field)
    u = field.to_numpy().astype(np.complex128)
    out = np.fft.ifft2(np.fft.fft2(u, s=h.shape) * h)[:ny, :nx]
    back = np.fft.ifft2(np.fft.fft2(2 * weights * out, s=h.shape) * h.conj())
    return out, back[:ny, :nx]


def compared(way: Way, expected: tuple[Array, Array]) -> str:
    """Relative errors of field and gradient, each but for a complex factor: a field's carrier."""
    words = []
    for what, run, right in zip(
        ("field", "gradient"), (way.forward, way.both), expected, strict=True
    ):
        got = way.to_numpy(run()).astype(np.complex128)
        factor = np.vdot(got, right) / np.vdot(got, got).real
        error = np.linalg.norm(factor * got - right) / np.linalg.norm(right)
        wrong = f" (its size wrong, {1 / abs(factor):.1e})" if abs(abs(factor) - 1) > 0.05 else ""
        words.append(f"{what} {error:.1e}{wrong}")
    return f"{way.name}: error of the {', '.join(words)}; {way.tape / 2**20:.0f} MiB kept."


def ways_of(field: Field, weights: Array) -> tuple[list[Way], list[str]]:
    """What is installed, and a sentence for each that is not."""
    ways, notes = [directly(field, weights)], []
    wanted = {
        "clplen.torch.apply": (through_torch, ("torch",), "torch"),
        "PyTorch by hand": (by_hand, ("torch",), "torch"),
        "torchoptics": (by_torchoptics, ("torch", "torchoptics"), "torchoptics"),
        "chromatix": (
            by_chromatix,
            ("jax", "equinox", "chromatix.elements"),
            "git+https://github.com/chromatix-team/chromatix",
        ),
    }
    for name, (make, modules, package) in wanted.items():
        missing = [module for module in modules if not _is_there(module)]
        if missing:
            notes.append(f"{name} left out: no {missing[0]} here; pip install {package}.")
        else:
            ways.append(make(field, weights))
    return ways, notes


def _is_there(module: str) -> bool:
    """Whether a module can be imported, its packages too."""
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def measure_peers(device: Device, size: str, repeats: int) -> Report:
    """Everybody forward, and forward and backward, in turn."""
    (n,) = numbers(size, (1,), "N")
    field = speckle(n, device)
    weights = np.random.default_rng(3).random((n, n), dtype=np.float32)
    ways, missing = ways_of(field, weights)
    expected = in_double(field, weights)
    notes = [
        "Errors are of the whole array, relative, against double precision but for a complex "
        "factor. Kept: what lies in memory between forward and backward, the input included.",
        *(compared(way, expected) for way in ways),
    ]
    cases = [
        Case(f"{way.name}{words}", finished(run, device), 1.0, "steps")
        for way in ways
        for words, run in (("", way.forward), (", and back", way.both))
    ]
    times = in_turn(cases, repeats)
    pairs = zip(times[::2], times[1::2], strict=True)
    rows = tuple(
        row
        for pair in pairs
        for one, base in zip(pair, times[:2], strict=True)
        for row in time_rows([one], base)
    )
    words = "time over clplen's, forward or both"
    return Report("gradients-peers", size, words, rows, (*notes, *missing))


def needs(size: str) -> int:
    """Padded arrays of five ways, their tapes, and the reference in double precision."""
    (n,) = numbers(size, (1,), "N")
    return 60 * 4 * 8 * n * n


BENCHMARK = Benchmark(
    "gradients-peers",
    "propagation and its gradient beside torchoptics, chromatix and PyTorch by hand",
    sizes=("1024", "2048"),
    quick="256",
    needs=needs,
    run=measure_peers,
)
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # threads of PyTorch do not spin beside us
main = command(BENCHMARK, __doc__)
