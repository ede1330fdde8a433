"""White images of lattices of lenslets, float64, anti-aliased by averaging samples in a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Drawn:
    """The lattice that was drawn: an origin and two primitive vectors (y, x), in pixels."""

    origin: Array
    first: Array
    second: Array

    def nearest(self, y: Array, x: Array) -> tuple[Array, Array, Array, Array]:
        """Indices of the nearest lenslet, and the way (dy, dx) from it."""
        m = np.array([self.first, self.second]).T
        inverse = np.linalg.inv(m)
        ry, rx = y - self.origin[0], x - self.origin[1]
        a, b = (inverse[i, 0] * ry + inverse[i, 1] * rx for i in (0, 1))
        best = None
        for da in (0, 1):
            for db in (0, 1):
                i, k = np.floor(a) + da, np.floor(b) + db
                dy = ry - m[0, 0] * i - m[0, 1] * k
                dx = rx - m[1, 0] * i - m[1, 1] * k
                r = dy * dy + dx * dx
                if best is None:
                    best = [r, i, k, dy, dx]
                else:
                    closer = r < best[0]
                    for old, new in zip(best, (r, i, k, dy, dx), strict=True):
                        old[closer] = new[closer]
        return best[1], best[2], best[3], best[4]

    def off(self, points: Array) -> Array:
        """How far (y, x) points lie from the nearest true centre, (n, 2)."""
        _, _, dy, dx = self.nearest(points[:, 0], points[:, 1])
        return np.stack([dy, dx], axis=1)


def lattice(
    kind: str, pitch: float, *, degrees: float = 0.0, stretch: float = 1.0, origin=(0.0, 0.0)
) -> Drawn:
    """Columns ``pitch`` apart along x, turned from +x to +y; y is stretched before turning."""
    t = np.deg2rad(degrees)
    turn = np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]])  # on (y, x)
    second = {"square": (1.0, 0.0), "hexagonal": (np.sqrt(3) / 2, 0.5)}
    if kind == "turned":
        steps = [np.array([0.5, np.sqrt(3) / 2]), np.array([1.0, 0.0])]
    else:
        steps = [np.array([0.0, 1.0]), np.array(second[kind])]
    scale = pitch * np.array([stretch, 1.0])
    return Drawn(np.array(origin), turn @ (scale * steps[0]), turn @ (scale * steps[1]))


def hashed(i: Array, k: Array) -> Array:
    """A number in [0, 1) that looks random, for a lenslet."""
    n = (i.astype(np.int64) * 73856093) ^ (k.astype(np.int64) * 19349663)
    n = (n ^ (n >> 13)) * 1274126177 & 0x7FFFFFFF
    return ((n ^ (n >> 16)) & 0xFFFF) / 65536.0


def profile(name: str, dy: Array, dx: Array, pitch: float) -> Array:
    """Brightness at (dy, dx) from a centre."""
    r = np.hypot(dy, dx) / pitch
    if name == "disc":  # a rim of a tenth of a pitch
        return np.clip((0.47 - r) / 0.1 + 0.5, 0, 1)
    if name == "gauss":
        return np.exp(-0.5 * (r / 0.22) ** 2)
    soft = [np.clip((0.45 - np.abs(d) / pitch) / 0.06 + 0.5, 0, 1) for d in (dy, dx)]
    return soft[0] * soft[1]


def white(
    shape: tuple[int, int],
    true: Drawn,
    *,
    name: str = "disc",
    dim: str = "none",
    level: float = 0.4,
    vignetting: float = 0.5,
    samples: int = 3,
) -> Array:
    """A white image: 1 at the brightest, dark between the lenslets.

    ``dim`` lenslets, "random", "second" (a chessboard) or "rows", have ``level`` times the light;
    the corners of the picture have ``1 - vignetting`` of the middle's.
    """
    ny, nx = shape
    pitch = min(np.hypot(*true.first), np.hypot(*true.second))
    out = np.zeros(shape)
    for a in range(samples):
        for b in range(samples):
            y = np.arange(ny)[:, None] + (a + 0.5) / samples - 0.5
            x = np.arange(nx)[None, :] + (b + 0.5) / samples - 0.5
            y, x = np.broadcast_arrays(y, x)
            i, k, dy, dx = true.nearest(y, x)
            weak = {
                "none": False,
                "random": hashed(i, k) < 0.5,
                "second": (i + k) % 2 == 1,
                "rows": k % 2 == 1,
            }[dim]
            out += profile(name, dy, dx, pitch) * np.where(weak, level, 1.0)
    y, x = np.mgrid[:ny, :nx]
    r2 = ((y / (ny - 1) - 0.5) ** 2 + (x / (nx - 1) - 0.45) ** 2) / 0.5
    return out / samples**2 * (1 - vignetting * r2)
