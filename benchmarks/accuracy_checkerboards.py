"""Calibration by checkerboards: intrinsics and metres beside those of cameras that are known.

    python benchmarks/accuracy_checkerboards.py [--device pocl] [--camera lytro] [--quick]

Light fields of a board of 6 x 9 corners and 18 mm in ten poses from .3 to 2 m, traced ray by ray
with 1 % of noise (`checkerboards.py`), through two cameras: one like a Lytro, whose
views converge at a fifth of a metre and whose rows and columns of pixels meet 6 mm apart, and an
array of parallel cameras; both with radial distortion. The first table holds the intrinsics.
The second one holds distances of boards that the calibration did not
see, at .3 to 2 m: from rays through their corners, and from `depth_map` of rectified views, which
searches half a distance against infinity on either side.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import NamedTuple

import click
import numpy as np
from checkerboards import (
    Array,
    KnownCamera,
    Pose,
    corners_in_space,
    made_camera,
    photographed,
    poses_at,
)

from clplen import Device, depth_map
from clplen.lightfield import Intrinsics, calibrate, find_corners, rectify_views

BOARD, SPACING = (6, 9), 0.018
DISTANCES = np.geomspace(0.3, 2.0, 10)
FRESH = (0.3, 0.5, 1.0, 2.0)
SURE = 0.5  # confidence of pixels that count


def cameras(quick: bool = False) -> dict[str, KnownCamera]:
    """The two cameras, by name."""
    small = 2 if quick else 1
    views, pixels = (5, 5) if quick else (9, 9), (384 // small, 512 // small)
    pitch = (1.40e-3 * small, 1.44e-3 * small)
    apart = 3e-3
    lytro = made_camera(
        (*views, *pixels),
        steps=(4.0e-4, 3.6e-4),
        converge=(-1.9e-3 * small, -1.7e-3 * small),
        pitch=pitch,
        centre=(6e-3, -9e-3),
        tilt=(apart * pitch[0], -apart * pitch[1]),
        distortion=(4e-3, -3e-3, 0.25, -0.3, 0.1),
    )
    array = made_camera(
        ((5, 5) if quick else (7, 7)) + pixels,
        steps=(4.0e-3, 4.0e-3),
        converge=(0.0, 0.0),
        pitch=(1.42e-3 * small, 1.42e-3 * small),
        centre=(-1.2e-2, 5e-3),
        distortion=(-2e-3, 1e-3, -0.2, 0.08, 0.0),
    )
    return {"lytro": lytro, "array": array}


def calibrated(camera: KnownCamera, device: Device) -> Intrinsics:
    """By ten boards."""
    boards = (
        photographed(camera, pose, BOARD, SPACING, seed=number)
        for number, pose in enumerate(poses_at(DISTANCES))
    )
    return calibrate(boards, BOARD, SPACING, device=device)


def errors(found: Intrinsics, camera: KnownCamera) -> dict[str, float]:
    """What is off: shares of the numbers of H in per cent, pixels and millimetres."""
    H, K = found.matrix, camera.matrix
    off = {}
    for name, row, column in (
        ("H11 %", 0, 0), ("H22 %", 1, 1), ("H33 %", 2, 2), ("H44 %", 3, 3),
        ("H31 %", 2, 0), ("H42 %", 3, 1),
    ):  # fmt: skip
        whole = K[row, column] or K[row, row]  # of parallel views, of the direction a pixel
        off[name] = 100 * (H[row, column] - K[row, column]) / whole
    off["rows and columns apart, mm"] = 1e3 * (_apart(H) - _apart(K))
    V, U, ny, nx = camera.shape
    l, k = np.mgrid[: ny : ny // 8, : nx : nx // 8]  # noqa: E741
    i, j = (U - 1) / 2, (V - 1) / 2
    turn = (found.rays(i, j, k, l) - np.moveaxis(camera.rays(i, j, k, l), 0, -1))[..., 2:]
    off["directions, px rms"] = float(np.sqrt((turn**2).sum(-1).mean()) / K[2, 2])
    off["distortion, px rms"] = float(np.sqrt((_bent(turn, k, l) ** 2).sum(-1).mean()) / K[2, 2])
    off["rms, px"] = found.rms
    return off


def _apart(H: Array) -> float:
    return float(H[0, 2] / H[2, 2] - H[1, 3] / H[3, 3])


def _bent(turn: Array, k: Array, l: Array) -> Array:  # noqa: E741
    """What is left of differences of directions without their linear part."""
    rows = np.stack([np.ones(k.size), k.ravel(), l.ravel()], -1)
    flat = turn.reshape(-1, 2)
    return flat - rows @ np.linalg.lstsq(rows, flat, rcond=None)[0]


class Distance(NamedTuple):
    """Errors of the distances of one board, in per cent of it."""

    metres: float
    corners_mean: float
    corners_rms: float
    map_median: float
    map_spread: float
    sure: float


def distances(
    found: Intrinsics, camera: KnownCamera, device: Device
) -> Iterator[Distance]:
    """Boards at `FRESH`, large enough to fill much of the view."""
    for number, z in enumerate(FRESH):
        spacing = SPACING * z / 0.3
        pose = Pose(z, (14.0, -18.0, 5.0), (0.01 * z, -0.006 * z))
        views = photographed(camera, pose, BOARD, spacing, seed=100 + number)
        off = _of_corners(found, views, pose, spacing, device)
        by_map, sure = _of_map(found, views, pose, spacing, device)
        yield Distance(
            z,
            100 * float(off.mean()),
            100 * float(np.sqrt((off**2).mean())),
            100 * float(np.median(by_map)),
            100 * float(np.median(np.abs(by_map - np.median(by_map)))),
            100 * sure,
        )


def _of_corners(
    found: Intrinsics, views: Array, pose: Pose, spacing: float, device: Device
) -> Array:
    """Relative errors of z of the points nearest to all rays of each corner."""
    corners = find_corners(views, BOARD, device=device)
    V, U = corners.shape[:2]
    j, i = np.mgrid[:V, :U][:, :, :, None]
    s, t, u, v = np.moveaxis(found.rays(i, j, corners[..., 1], corners[..., 0]), -1, 0)
    z = []
    for n in range(corners.shape[2]):
        a, b, x, y = (values[..., n].ravel() for values in (u, v, s, t))
        known = np.isfinite(a)
        one, none = np.ones(known.sum()), np.zeros(known.sum())
        rows = np.concatenate(
            [np.stack([one, none, -a[known]], -1), np.stack([none, one, -b[known]], -1)]
        )
        z.append(np.linalg.lstsq(rows, np.concatenate([x[known], y[known]]), rcond=None)[0][2])
    true = corners_in_space(pose, BOARD, spacing)[:, 2]
    measured = np.array(z)
    return min((measured, measured[::-1]), key=lambda z: abs(z - true).sum()) / true - 1


def _of_map(
    found: Intrinsics, views: Array, pose: Pose, spacing: float, device: Device
) -> tuple[Array, float]:
    """Relative errors of z in the sure pixels of a board, and their share."""
    flat = rectify_views(views, found, device=device)
    far = found.rectified.disparity(pose.distance)
    slope = abs(found.baseline) / pose.distance / found.rectified.matrix[2, 2]
    depth = depth_map(flat, disparities=far + slope * np.linspace(-0.5, 0.5, 33))
    V, U, ny, nx = found.shape
    l, k = np.mgrid[:ny, :nx]  # noqa: E741
    u, v = np.moveaxis(found.rectified.rays((U - 1) / 2, (V - 1) / 2, k, l), -1, 0)[2:]
    normal = pose.rotation[:, 2]
    true = normal @ pose.middle / (normal[0] * u + normal[1] * v + normal[2])
    at = np.stack([u * true, v * true, true], -1) - pose.middle
    inside = np.abs(at @ pose.rotation[:, 0]) < (BOARD[1] + 1) / 2 * spacing
    inside &= np.abs(at @ pose.rotation[:, 1]) < (BOARD[0] + 1) / 2 * spacing
    sure = inside & (depth.confidence > SURE)
    z = found.rectified.depth(depth.disparity)
    return (z / true - 1)[sure], float(sure.sum() / inside.sum())


def table(rows: list[tuple[str, ...]]) -> str:
    """Columns side by side, the first to the left."""
    wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *rest in rows:
        cells = [text.rjust(n) for text, n in zip(rest, wide[1:], strict=True)]
        lines.append("  ".join([first.ljust(wide[0]), *cells]))
    return "\n".join(lines)


@click.command(help=f"\b\n{__doc__}")
@click.option("--device", "selector", help="As Device.open takes it.")
@click.option("--camera", "names", multiple=True, type=click.Choice(["lytro", "array"]))
@click.option("--quick", is_flag=True, help="Small pictures, to see that it works.")
def main(selector: str | None, names: tuple[str, ...], quick: bool) -> None:
    device = Device.open(selector)
    known = cameras(quick)
    for name in names or known:
        start = time.perf_counter()
        found = calibrated(known[name], device)
        took = time.perf_counter() - start
        used = int(np.isfinite(found.board_rms).sum())
        click.echo(f"\n{name}: {found}; {used} boards, pictures and calibration {took:.0f} s")
        rows = [(key, f"{value:+.4f}") for key, value in errors(found, known[name]).items()]
        click.echo(table([("intrinsics", "error"), *rows]))
        rows = [
            (f"{d.metres:g}", *(f"{value:+.3f}" for value in d[1:5]), f"{d.sure:.0f}")
            for d in distances(found, known[name], device)
        ]
        head = ("m", "corners mean %", "rms %", "map median %", "spread %", "sure %")
        click.echo(table([head, *rows]))


if __name__ == "__main__":
    main()
