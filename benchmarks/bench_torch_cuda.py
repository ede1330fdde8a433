"""clplen beside code by hand with PyTorch on the same NVIDIA GPU: a step of propagation, a stack.

    python benchmarks/bench_torch_cuda.py [--repeats 9] [--quick]

A step: N x N samples padded to 2N, a transfer function that is there already, complex64; by hand
`fft2`, a product, `ifft2` and a slice (cuFFT). A stack: linear interpolation of every view on 32
planes; by hand one `grid_sample` of all views a plane, and the mean. Data are on the GPU before and
after. The results are compared, steps with complex128 on the GPU. The two take turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import click
import numpy as np

from clplen import Device, Field, Grid, LightField, focal_stack, propagate

WAVELENGTH, PITCH, PLANES = 500e-9, 5e-6, 32
FIELDS, QUICK_FIELDS = (1024, 2048, 4096), (256,)
VIEWS, QUICK_VIEWS = ((15, 15, 434, 625, 3), (9, 9, 512, 512, 1)), ((3, 3, 40, 50, 3),)


def medians(cases: list[Callable[[], Any]], finish: list[Callable[[], Any]], repeats: int) -> Any:
    """Seconds of each case; they take turns."""
    times: list[list[float]] = [[] for _ in cases]
    for turn in range(repeats + 2):
        for taken, case, done in zip(times, cases, finish, strict=True):
            done()
            start = time.perf_counter()
            case()
            done()
            if turn > 1:
                taken.append(time.perf_counter() - start)
    return [float(np.median(taken)) for taken in times]


def step(n: int, device: Device, torch: Any, repeats: int) -> str:
    """A step of N x N samples over 20 mm."""
    z = 0.02
    random = np.random.default_rng(0)
    grid = Grid((n, n), PITCH)
    values = random.standard_normal((n, n)) + 1j * random.standard_normal((n, n))
    field = Field.from_array(values, grid, wavelength=WAVELENGTH, device=device)
    report = propagate(field, z, method="as", pad=2)
    f = torch.fft.fftfreq(2 * n, PITCH, dtype=torch.float64, device="cuda")
    under = torch.clamp(1 / WAVELENGTH**2 - f[:, None] ** 2 - f**2, min=0)
    exact = torch.exp(2j * np.pi * z * torch.sqrt(under))
    single = exact.to(torch.complex64)
    there = torch.as_tensor(values, device="cuda")
    light = there.to(torch.complex64)

    def by_hand(u: Any, h: Any) -> Any:
        return torch.fft.ifft2(torch.fft.fft2(u, s=(2 * n, 2 * n)) * h)[:n, :n]

    cases = [
        lambda: propagate(field, z, method="as", pad=2),
        lambda: by_hand(light, single),
    ]
    ours, theirs = medians(cases, [device.finish, torch.cuda.synchronize], repeats)
    reference = by_hand(there, exact).cpu().numpy()
    errors = [
        np.linalg.norm(got - reference) / np.linalg.norm(reference)
        for got in (report.to_numpy(), by_hand(light, single).cpu().numpy())
    ]
    return (
        f"step {n}: clplen {ours * 1e3:.3g} ms (error {errors[0]:.1e}), torch {theirs * 1e3:.3g} "
        f"ms ({errors[1]:.1e}); torch over clplen {theirs / ours:.2f}"
    )


def stack(shape: tuple[int, ...], device: Device, torch: Any, repeats: int) -> str:
    """Planes of disparity -1.5 to 1.5."""
    V, U, ny, nx, channels = shape
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    lf = LightField.from_array(values if channels > 1 else values[..., 0], device=device)
    disparities = np.linspace(-1.5, 1.5, PLANES)
    views = torch.as_tensor(values, device="cuda").reshape(V * U, ny, nx, channels)
    views = views.permute(0, 3, 1, 2).contiguous()
    v, u = np.indices((V, U)).reshape(2, -1)
    away = torch.as_tensor(
        np.stack([u - (U - 1) / 2, v - (V - 1) / 2], axis=-1), dtype=torch.float32, device="cuda"
    )
    y = torch.linspace(-1, 1, ny, device="cuda")
    x = torch.linspace(-1, 1, nx, device="cuda")
    base = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    scale = torch.tensor([2 / (nx - 1), 2 / (ny - 1)], device="cuda")

    def by_hand() -> Any:
        planes = []
        for disparity in disparities:
            places = base + (away * float(disparity) * scale)[:, None, None]
            shifted = torch.nn.functional.grid_sample(views, places, align_corners=True)
            planes.append(shifted.mean(0))
        return torch.stack(planes)

    def with_clplen() -> Any:
        return focal_stack(lf, disparities=disparities)

    ours, theirs = medians([with_clplen, by_hand], [device.finish, torch.cuda.synchronize], repeats)
    inside = slice(30, -30) if min(ny, nx) > 100 else slice(10, -10)
    mine = np.asarray(with_clplen().to_numpy()).reshape(PLANES, ny, nx, channels)[:, inside, inside]
    hand: dict[int, Any] = dict.fromkeys((1, -1))
    for sign in hand:
        disparities = sign * disparities
        hand[sign] = by_hand().permute(0, 2, 3, 1).cpu().numpy()[:, inside, inside]
    difference = min(float(np.abs(mine - one).max()) for one in hand.values() if one is not None)
    rays = PLANES * float(np.prod(shape[:4]))  # a pixel of a view, used for one plane
    return (
        f"stack {'x'.join(map(str, shape))}: clplen {rays / ours / 1e9:.4g} Gray/s "
        f"({ours * 1e3:.3g} ms), torch {rays / theirs / 1e9:.4g} ({theirs * 1e3:.3g} ms); torch "
        f"over clplen {theirs / ours:.2f}; largest difference inside {difference:.1e}"
    )


@click.command(help=__doc__)
@click.option("--repeats", default=9, show_default=True, type=click.IntRange(1))
@click.option("--quick", is_flag=True, help="Small sizes.")
def main(repeats: int, quick: bool) -> None:
    try:
        import torch
    except ImportError:
        raise click.ClickException("This needs PyTorch with CUDA: pip install torch.") from None
    if not torch.cuda.is_available():
        raise click.ClickException("This needs an NVIDIA GPU, and PyTorch sees none.")
    device = Device.open("nvidia")
    click.echo(f"{device!r}; torch {torch.__version__}, {torch.cuda.get_device_name()}")
    for n in QUICK_FIELDS if quick else FIELDS:
        click.echo(step(n, device, torch, repeats))
    for shape in QUICK_VIEWS if quick else VIEWS:
        click.echo(stack(shape, device, torch, repeats))


if __name__ == "__main__":
    main()
