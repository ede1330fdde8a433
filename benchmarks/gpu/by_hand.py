"""Steps and stacks beside code by hand in PyTorch and CuPy on the same device.

    python -m benchmarks gpu/by_hand [--device gpu] [--repeats 9] [--quick]

A step: N x N samples padded to 2N, a transfer function that is there already, complex64; by hand
`ifft2(fft2(u, 2N x 2N) * H)` and a slice. A stack: linear interpolation of every view on 32 planes;
by hand one `grid_sample` of all views a plane, and the mean. Data are on the device before and
after. All take turns, with a copy of the field or of the views, which nothing can beat. Results are
compared, steps with complex128. PyTorch takes the first CUDA device, else the CPU; CuPy is left
out where it is not installed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import click
import numpy as np
import torch

from clplen import Device, Field, Grid, LightField, focal_stack, propagate

try:
    import cupy
except ImportError:
    cupy = None

WAVELENGTH, PITCH, DISTANCE, PLANES = 500e-9, 5e-6, 0.02, 32
FIELDS, QUICK_FIELDS = (1024, 2048, 4096), (256,)
VIEWS = ((15, 15, 434, 625, 3), (9, 9, 512, 512, 1), (17, 17, 768, 768, 1))
QUICK_VIEWS = ((3, 3, 40, 50, 3),)
PLACE = "cuda" if torch.cuda.is_available() else "cpu"


def wait() -> None:
    """Wait for what PyTorch and CuPy have begun."""
    if PLACE == "cuda":
        torch.cuda.synchronize()


def medians(cases: dict[str, Callable[[], Any]], device: Device, repeats: int) -> dict[str, float]:
    """Return the median of the seconds of each case; the cases take turns."""
    times: dict[str, list[float]] = {name: [] for name in cases}
    for turn in range(repeats + 2):
        for name, case in cases.items():
            device.finish()
            wait()
            start = time.perf_counter()
            case()
            device.finish()
            wait()
            if turn > 1:
                times[name].append(time.perf_counter() - start)
    return {name: float(np.median(taken)) for name, taken in times.items()}


def line(title: str, seconds: dict[str, float], ours: str = "clplen") -> str:
    """Return a line with the milliseconds of each case and its ratio to ours."""
    parts = [f"{name} {t * 1e3:.3g} ms ({t / seconds[ours]:.2f})" for name, t in seconds.items()]
    return f"{title}: " + ", ".join(parts)


def step(n: int, device: Device, repeats: int) -> str:
    """Measure a step of N x N samples."""
    random = np.random.default_rng(0)
    grid = Grid((n, n), PITCH)
    values = random.standard_normal((n, n)) + 1j * random.standard_normal((n, n))
    field = Field.from_array(values, grid, wavelength=WAVELENGTH, device=device)
    f = torch.fft.fftfreq(2 * n, PITCH, dtype=torch.float64, device=PLACE)
    under = torch.clamp(1 / WAVELENGTH**2 - f[:, None] ** 2 - f**2, min=0)
    exact = torch.exp(2j * np.pi * DISTANCE * torch.sqrt(under))
    single = exact.to(torch.complex64)
    there = torch.as_tensor(values, device=PLACE)
    light = there.to(torch.complex64)

    def by_hand(u: Any, h: Any) -> Any:
        return torch.fft.ifft2(torch.fft.fft2(u, s=(2 * n, 2 * n)) * h)[:n, :n]

    def ours() -> Field:
        return propagate(field, DISTANCE, method="as", pad=2)

    cases: dict[str, Callable[[], Any]] = {
        "clplen": ours,
        "torch": lambda: by_hand(light, single),
        "copy of the field": light.clone,
    }
    if cupy is not None:
        u, h = cupy.asarray(light), cupy.asarray(single)
        cases["cupy"] = lambda: cupy.fft.ifft2(cupy.fft.fft2(u, s=(2 * n, 2 * n)) * h)[:n, :n]
    reference = by_hand(there, exact).cpu().numpy()
    errors = [
        np.linalg.norm(got - reference) / np.linalg.norm(reference)
        for got in (ours().to_numpy(), by_hand(light, single).cpu().numpy())
    ]
    title = f"step {n} (errors of clplen {errors[0]:.1e}, torch {errors[1]:.1e})"
    return line(title, medians(cases, device, repeats))


def stack(shape: tuple[int, ...], device: Device, repeats: int) -> str:
    """Measure planes of disparity -1.5 to 1.5."""
    V, U, ny, nx, channels = shape
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    lf = LightField.from_array(values if channels > 1 else values[..., 0], device=device)
    disparities = np.linspace(-1.5, 1.5, PLANES)
    views = torch.as_tensor(values, device=PLACE).reshape(V * U, ny, nx, channels)
    views = views.permute(0, 3, 1, 2).contiguous()
    v, u = np.indices((V, U)).reshape(2, -1)
    away = torch.as_tensor(
        np.stack([u - (U - 1) / 2, v - (V - 1) / 2], axis=-1), dtype=torch.float32, device=PLACE
    )
    y = torch.linspace(-1, 1, ny, device=PLACE)
    x = torch.linspace(-1, 1, nx, device=PLACE)
    base = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    scale = torch.tensor([2 / (nx - 1), 2 / (ny - 1)], device=PLACE)

    def by_hand(sign: int = 1) -> Any:
        planes = []
        for disparity in sign * disparities:
            places = base + (away * float(disparity) * scale)[:, None, None]
            shifted = torch.nn.functional.grid_sample(views, places, align_corners=True)
            planes.append(shifted.mean(0))
        return torch.stack(planes)

    def ours() -> Any:
        return focal_stack(lf, disparities=disparities)

    seconds = medians(
        {"clplen": ours, "torch": by_hand, "copy of the views": views.clone}, device, repeats
    )
    cut = 30 if min(ny, nx) > 100 else 10
    inside = (slice(None), slice(cut, -cut), slice(cut, -cut))
    mine = np.asarray(ours().to_numpy()).reshape(PLANES, ny, nx, channels)[inside]
    difference = min(
        float(np.abs(mine - by_hand(sign).permute(0, 2, 3, 1).cpu().numpy()[inside]).max())
        for sign in (1, -1)
    )
    rays = PLANES * float(np.prod(shape[:4]))  # a pixel of a view, used for one plane
    rate = f"{rays / seconds['clplen'] / 1e9:.4g} Gray/s"
    title = f"stack {'x'.join(map(str, shape))}"
    return line(f"{title} ({rate}, largest difference inside {difference:.1e})", seconds)


@click.command()
@click.option("--device", "selector", default="gpu", show_default=True)
@click.option("--repeats", default=9, show_default=True, type=click.IntRange(1))
@click.option("--quick", is_flag=True, help="Small sizes.")
def main(selector: str, repeats: int, quick: bool) -> None:
    device = Device.open(selector)
    beside = torch.cuda.get_device_name() if PLACE == "cuda" else "the CPU"
    click.echo(f"{device!r}; torch {torch.__version__} on {beside}")
    for n in QUICK_FIELDS if quick else FIELDS:
        click.echo(step(n, device, repeats))
    for shape in QUICK_VIEWS if quick else VIEWS:
        click.echo(stack(shape, device, repeats))

