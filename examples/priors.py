"""Volumes from one frame of a light-field microscope: without a prior, and with three.

Richardson and Lucy's iteration knows that volumes are positive. FISTA (Beck and Teboulle 2009) adds
total variation to photon-weighted least squares. A small network, trained on volumes drawn like the
true one, corrects a first volume by what the frame says against it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from common import BLUE, GREEN, ORANGE
from drawing import LIGHT

from clplen import Projector, deconvolve

BEAD, THREAD = 3.5e-6, 2.5e-6  # radii
SOFT = 0.2  # of a radius: the edge
START = 20  # iterations before the network


@dataclass(frozen=True)
class Volumes:
    """Where voxels are, and how bright what is drawn there is.

    Attributes
    ----------
    z, x : numpy.ndarray
        In metres; y as x.
    photons : float
        Of a frame.
    """

    z: np.ndarray
    x: np.ndarray
    photons: float

    def balls(self, places: np.ndarray, radii: np.ndarray, light: np.ndarray) -> np.ndarray:
        """The brightest of balls with soft edges, about (z, y, x); deeper by half a plane."""
        z, y, x = (np.subtract.outer(at, axis) ** 2
                   for at, axis in zip(places.T, (self.z, self.x, self.x), strict=True))
        deep = 1 / (1 + (self.z[1] - self.z[0]) / (2 * radii)) ** 2
        r = np.sqrt((z * deep[:, None])[:, :, None, None] + y[:, None, :, None]
                    + x[:, None, None]) / radii[:, None, None, None]
        edge = np.clip((1 - r) / SOFT + 0.5, 0, 1) * light[:, None, None, None]
        return edge.max(axis=0).astype(np.float32)

    def drawn(self, rng: Any, beads: int = 6) -> np.ndarray:
        """Beads anywhere and a filament through all planes, random; float32."""
        t = np.linspace(-1, 1, 60)
        wave, turn, far = rng.uniform(-1, 1, (3, 2))
        reach = np.array([self.z[-1], *(0.55 * self.x[-1],) * 2])
        across = wave[:, None] * np.sin(2 * t + 3 * turn[:, None]) + far[:, None] * t
        thread = reach * np.stack([t * rng.choice((-1, 1)), *(0.7 * across)], axis=1)
        places = reach * rng.uniform(-1, 1, (beads, 3)) * (0.95, 1.3, 1.3)
        radii = np.concatenate([np.full(60, THREAD), np.full(beads, BEAD)])
        light = np.concatenate([np.full(60, 0.7), rng.uniform(0.6, 1.2, beads)])
        return self.balls(np.concatenate([thread, places]), radii, light)

    def taken(self, volume: np.ndarray, projector: Projector, rng: Any) -> tuple[Any, Any]:
        """Volumes so bright that their frames have so many photons, and frames with noise."""
        means = projector.forward(volume)
        scale = (self.photons / means.sum(axis=(-2, -1)))[..., None, None]
        frames = rng.poisson(np.maximum(means * scale, 0)).astype(np.float32)
        return volume * scale[..., None], frames


def error(volume: np.ndarray, true: np.ndarray) -> float:
    """Root of the mean square difference over that of the truth."""
    return float(np.linalg.norm(volume - true) / np.linalg.norm(true))


def misfit(volume: np.ndarray, frame: np.ndarray, projector: Projector) -> float:
    """Mean square of what is left over the mean count: 1 where it is photon noise alone."""
    mean = projector.forward(volume)
    return float(((frame - mean) ** 2).sum() / mean.sum())


def richardson_lucy(frame: np.ndarray, projector: Projector, counts: Any) -> list[np.ndarray]:
    """The volume after each of so many iterations."""
    found, before = [], 0
    for count in counts:
        start = found[-1] if found else None
        found.append(deconvolve(frame, projector, iterations=count - before, start=start).volume)
        before = count
    return found


def slopes(volume: np.ndarray) -> np.ndarray:
    """Forward differences along z, y, x; 0 at the ends."""
    return np.stack([np.diff(volume, axis=k, append=volume.take([-1], k)) for k in range(3)])


def divergence(p: np.ndarray) -> np.ndarray:
    """-slopes'(p)."""
    out = np.zeros_like(p[0])
    for k, one in enumerate(p):
        inner = np.moveaxis(one, k, 0)[:-1]
        there = np.moveaxis(out, k, 0)
        there[:-1] += inner
        there[1:] -= inner
    return out


def flattened(volume: np.ndarray, strength: float, dual: np.ndarray, times: int = 8) -> np.ndarray:
    """Volume of less total variation, not negative; changes its dual variable, which is kept."""
    for _ in range(times):
        now = np.maximum(volume + strength * divergence(dual), 0)
        dual += slopes(now) / (12 * strength)
        dual /= np.maximum(1, np.sqrt((dual**2).sum(axis=0)))
    return np.maximum(volume + strength * divergence(dual), 0)


def fista(frame: np.ndarray, projector: Projector, strength: float, *, iterations: int,
          dark: float, start: np.ndarray) -> np.ndarray:
    """min sum (I - HV)^2/(2 s) + strength TV(V) over V >= 0, s the counts' variance as found."""
    weight = 1 / np.maximum(projector.forward(start), dark)
    probe = start / np.linalg.norm(start)
    for _ in range(12):  # the largest eigenvalue of H'(w H)
        probe = projector.backward(weight * projector.forward(probe, clamp=False))
        largest = float(np.linalg.norm(probe))
        probe /= largest
    step, t = 1 / (1.05 * largest), 1.0
    volume, ahead = start, start
    dual = np.zeros((3, *start.shape), np.float32)
    for _ in range(iterations):
        left = weight * (projector.forward(ahead, clamp=False) - frame)
        moved = flattened(ahead - step * projector.backward(left), step * strength, dual)
        after = (1 + np.sqrt(1 + 4 * t * t)) / 2
        ahead = moved + (t - 1) / after * (moved - volume)
        volume, t = moved, after
    return volume


def first(frames: np.ndarray, projector: Projector) -> list[np.ndarray]:
    """What the network sees: a first volume, and its next factors by the frames."""
    volume = deconvolve(frames, projector, iterations=START).volume
    mean = projector.forward(volume)
    ratio = frames / (mean + 0.05 * mean.max(axis=(-2, -1), keepdims=True))
    factors = projector.backward(ratio)
    return [volume, factors / factors.mean(axis=(-3, -2, -1), keepdims=True)]


def trained(volumes: Volumes, projector: Projector, *, steps: int, channels: int, many: int,
            seed: int = 1) -> Callable[[np.ndarray], np.ndarray] | None:
    """The volume of a frame by a network trained through the projector; None without PyTorch."""
    if find_spec("torch") is None:
        print('  the network needs PyTorch: pip install "clplen[torch]"')
        return None
    import torch

    import clplen.torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)  # the device has the cores
    rng, planes = np.random.default_rng(seed), len(volumes.z)
    layers = [torch.nn.Conv2d(2 * planes, channels, 3, padding=1), torch.nn.GELU()]
    for wide in (1, 2, 4):
        layers += [torch.nn.Conv2d(channels, channels, 3, padding=wide, dilation=wide),
                   torch.nn.GELU()]
    last = torch.nn.Conv2d(channels, planes, 3, padding=1)
    torch.nn.init.zeros_(last.weight)  # it begins with the volume as it is
    network = torch.nn.Sequential(*layers, last)

    def corrected(start: torch.Tensor, factors: torch.Tensor) -> torch.Tensor:
        size = start.amax(dim=(1, 2, 3), keepdim=True)
        root = (start / size).sqrt()
        return size * (root + network(torch.cat([root, factors], dim=1))) ** 2

    true, frames = volumes.taken(np.stack([volumes.drawn(rng) for _ in range(many)]), projector,
                                 rng)
    given = [torch.from_numpy(np.ascontiguousarray(one, np.float32))
             for one in (true, frames, *first(frames, projector))]
    optimizer = torch.optim.Adam(network.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, total_steps=steps)
    losses = []
    for _ in range(steps):
        some = torch.from_numpy(rng.choice(many, 4, replace=False))
        want, frame, *seen = (one[some] for one in given)
        got = corrected(*seen)
        mean = clplen.torch.apply(projector, got)
        loss = ((got - want) ** 2).sum() / (want**2).sum()
        loss = loss + 0.3 * ((mean - frame) ** 2).sum() / (frame**2).sum()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 0.3)
        optimizer.step()
        schedule.step()
        losses.append(loss.item())

    def network_of(frame: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return corrected(*map(torch.from_numpy, first(frame[None], projector)))[0].numpy()

    print(f"  loss of the network from {losses[0]:.3f} to {np.mean(losses[-steps // 4:]):.3f}")
    return network_of


def print_others(volumes: Volumes, projector: Projector, strength: float, learned: Any,
                 many: int) -> None:
    """Mean errors on so many other frames, which nothing was chosen by."""
    rng = np.random.default_rng(99)
    true, frames = volumes.taken(np.stack([volumes.drawn(rng) for _ in range(many)]), projector,
                                 rng)
    found: dict[str, list[float]] = {}
    for want, frame in zip(true, frames, strict=True):
        start, plain = richardson_lucy(frame, projector, (20, 40))
        flat = fista(frame, projector, strength, iterations=40, dark=0.2 * frame.mean(),
                     start=start)
        ways = {"Richardson-Lucy, 40 iterations": plain, "total variation": flat}
        if learned:
            ways["network"] = learned(frame)
        for name, volume in ways.items():
            found.setdefault(name, []).append(error(volume, want))
    words = ", ".join(f"{name} {np.mean(one):.3f}" for name, one in found.items())
    print(f"  mean error on {many} other frames: {words}")


def draw_errors(axes: Any, counts: Any, errors: Any, found: dict[str, np.ndarray],
                true: np.ndarray) -> None:
    """Error of Richardson and Lucy's iteration over its steps, beside that of what follows it."""
    axes.plot(counts, errors, "o-", color=BLUE, ms=3, label="Richardson-Lucy")
    for (name, volume), colour in zip([*found.items()][1:], (ORANGE, GREEN), strict=False):
        axes.axhline(error(volume, true), color=colour, label=name)
    axes.set(xlabel="iterations", ylabel="error")
    axes.legend()


def draw_missing(panels: Any) -> None:
    """What is not drawn without PyTorch."""
    for axes in panels.flat:
        axes.text(0.5, 0.5, 'PyTorch is missing:\npip install "clplen[torch]"', ha="center")
        axes.set_axis_off()


def draw_frame(axes: Any, frame: np.ndarray, volumes: Volumes) -> None:
    """Root of the counts over the largest; in um of the object."""
    side = volumes.x[-1] * 1e6 * len(volumes.x) / (len(volumes.x) - 1)
    axes.imshow(np.sqrt(frame / frame.max()), cmap=LIGHT, extent=(-side, side, side, -side))
    axes.set(xlabel="x/M / um", ylabel="y/M / um", title=f"raw frame, {frame.sum():.0f} photons")


def draw(column: Any, volume: np.ndarray, most: float, volumes: Volumes, title: str) -> Any:
    """The largest voxels along z and y, root of those of the truth; in um."""
    side, step = volumes.x[-1] * 1e6, (volumes.z[1] - volumes.z[0]) * 5e5
    side *= len(volumes.x) / (len(volumes.x) - 1)
    deep = (volumes.z[0] * 1e6 - step, volumes.z[-1] * 1e6 + step)
    for axes, axis, ends, up in zip(column, (0, 1), ((side, -side), deep), "yz", strict=True):
        drawn = axes.imshow(np.sqrt(np.maximum(volume, 0).max(axis=axis) / most), cmap=LIGHT,
                            extent=(-side, side, *ends), vmin=0, vmax=1,
                            origin="lower" if axis else "upper")
        axes.set(xlabel="x / um", ylabel=f"{up} / um")
    column[0].set_title(title)
    return drawn
