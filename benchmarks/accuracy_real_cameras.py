"""How right the depth of points is that real cameras take, by waves, with pixels that integrate.

    python benchmarks/accuracy_real_cameras.py [--device pocl] [--points 40] [--only illum]

The cameras are parts of those in examples/cameras. Points lie at random places and depths, at
which their blur covers 2 to 8 lenslets (Illum, Raytrix) or 2 to 5 (bench). Of the 1.0 cameras two
lines say how light fields are decoded: places and slopes dx/du of points by rays, which decoding
leaves as they are, and by waves, where diffraction at the lenslets flattens slopes. Then
alpha = F/F' by `estimate_alpha`, and of the 2.0 camera m = b/a by `point_m`; `cover` is the share
of points within the stated uncertainty, and within twice that. Two minutes in all.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np

from clplen import Device, LightField, PointSources, estimate_alpha, read_camera
from clplen.cameras import Plenoptic1, Plenoptic2
from clplen.lightfield import point_m

CAMERAS = Path(__file__).parents[1] / "examples" / "cameras"
METHODS = ("energy", "compensated", "slope")
WIDEST = {"illum": 8.0, "bench": 5.0}  # blur in lenslets
DECODED = 6  # points by rays
Values = np.ndarray[Any, Any]


def positions(camera: Plenoptic1, count: int, widest: float) -> Values:
    """Points (x, y, dz) on either side of the focus, imaged within 4 lenslets of the axis."""
    generator = np.random.default_rng(7)
    blur = generator.uniform(2, widest, count) * generator.choice((-1, 1), count)
    dz = camera.dz(1 + blur * camera.mla.pitch / camera.aperture_diameter)
    places = generator.uniform(-4, 4, (count, 2)) * camera.mla.pitch
    return np.column_stack([places / camera.array_scale(dz)[:, None], dz])


def line(lf: LightField, radius: float) -> tuple[float, Values]:
    """Slope of a point's centroid (x, y) over (u, v) within a radius on the lens, and its place."""
    samples = lf.to_numpy().astype(np.float64)
    axes = [(np.arange(n) - (n - 1) / 2) * d for n, d in zip(lf.shape, lf.spacing, strict=True)]
    total = samples.sum((2, 3))
    y = samples.sum(3) @ axes[2] / np.maximum(total, 1e-30)
    x = samples.sum(2) @ axes[3] / np.maximum(total, 1e-30)
    v, u = np.meshgrid(axes[0], axes[1], indexing="ij")
    weight = total * (np.hypot(v, u) < radius)
    weight /= weight.sum()
    up, down = 0.0, 0.0
    place = []
    for along, at in ((u, x), (v, y)):
        middle = (weight * along).sum()
        up += (weight * (along - middle) * at).sum()
        down += (weight * (along - middle) ** 2).sum()
        place.append((weight * at).sum())
    return up / down, np.array(place)


def decoded(camera: Plenoptic1, points: Values) -> Iterator[str]:
    """Slopes over 1 - alpha and places off, of the first points."""
    for model in ("rays", "waves"):
        ratios, off = [], []
        for point in points[:DECODED]:
            raw = camera.expose(PointSources(point), model=model)
            slope, place = line(LightField.from_raw(raw), 0.45 * camera.aperture_diameter)
            ratios.append(slope / (1 - camera.alpha(point[2])))
            off.append(np.abs(place - camera.on_array(point)[0]).max() / camera.mla.pitch)
        yield (
            f"decoded, by {model}: dx/du over 1 - alpha {np.mean(ratios):.4f} (rms from point to "
            f"point {np.std(ratios):.4f}), places within {max(off):.3f} lenslets"
        )


def said(name: str, error: Values, stated: Values, unit: float, words: str) -> str:
    """Bias, rms and cover of errors, in a unit."""
    known = np.isfinite(error) & np.isfinite(stated)
    error, stated = error[known], stated[known]
    within = [(np.abs(error) <= k * stated).mean() for k in (1, 2)]
    return (
        f"{name:12s} n {known.sum():3d} of {known.size}  bias {error.mean():+.2e}  rms "
        f"{np.sqrt((error**2).mean()):.2e} = {np.sqrt((error**2).mean()) / unit:.3f} {words}  "
        f"cover {within[0]:.2f} {within[1]:.2f}"
    )


def standard(camera: Plenoptic1, count: int, widest: float) -> Iterator[str]:
    """Decoding, then alpha by each method."""
    points = positions(camera, count, widest)
    yield from decoded(camera, points)
    tolerance = camera.mla.pitch / camera.aperture_diameter
    steepest = np.abs(camera.alpha(points[:, 2]) - 1).max()
    # the farthest point by a third of the search range from its end
    c_max = 1.5 * steepest * camera.image_distance / camera.sensor_distance
    c_max /= camera.pixels_per_lenslet
    found = {method: np.empty((2, count)) for method in METHODS}
    for n, point in enumerate(points):
        lf = LightField.from_raw(camera.expose(PointSources(point)))
        for method in METHODS:
            estimate = estimate_alpha(lf, method=method, c_max=c_max)
            error = estimate.alpha - estimate.bias - camera.alpha(point[2])
            found[method][:, n] = error, estimate.uncertainty
    yield f"p/D = {tolerance:.5f}, c_max = {c_max:.2f} pixels a view step"
    for method, (error, stated) in found.items():
        yield said(method, error, stated, tolerance, "p/D")


def focused(camera: Plenoptic2, count: int) -> Iterator[str]:
    """m by the pitch of the spots."""
    generator = np.random.default_rng(8)
    b, z2 = camera.b, camera.array_distance
    lenslets = generator.uniform(3, 8, count)  # D abs(a')/(z2 p), a' the virtual depth times b
    m = -b / (lenslets * camera.mla.pitch * z2 / camera.aperture_diameter)
    dz = camera.dz(camera.image_distance / (z2 - b / m))
    places = generator.uniform(-2, 2, (count, 2)) * camera.mla.pitch
    points = np.column_stack([places / camera.array_scale(dz)[:, None], dz])
    fits = [point_m(camera.expose(PointSources(p))) for p in points]
    relative = np.array([fit.m for fit in fits]) / m - 1
    stated = np.array([fit.uncertainty for fit in fits]) / np.abs(m)
    near = lenslets < np.median(lenslets)
    for name, part in (("all", near | True), ("small blur", near), ("large blur", ~near)):
        off, ratio = relative[part], np.abs(relative[part]) / stated[part]
        yield (
            f"m, {name:10s} n {part.sum():3d}  bias {100 * off.mean():+.3f} %  rms "
            f"{100 * np.sqrt((off**2).mean()):.3f} %  largest {100 * np.abs(off).max():.3f} %  "
            f"cover {(ratio <= 1).mean():.2f} {(ratio <= 2).mean():.2f}"
        )


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--points", default=40, show_default=True)
@click.option("--only", default="illum,bench,raytrix", show_default=True)
def main(selector: str | None, points: int, only: str) -> None:
    """A few lines for each camera."""
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    files = {
        "illum": ("lytro_illum", (41, 43)),
        "bench": ("canon_50mm", (33, 35)),
        "raytrix": ("raytrix_r12", (31, 29)),
    }
    for name in only.split(","):
        file, lenslets = files[name]
        camera = read_camera(CAMERAS / f"{file}.toml", device=device, count=lenslets)
        click.echo(f"{file}, {lenslets[0]} x {lenslets[1]} lenslets")
        if isinstance(camera, Plenoptic2):
            lines = focused(camera, points)
        else:
            assert isinstance(camera, Plenoptic1)
            lines = standard(camera, points, WIDEST[name])
        for one in lines:
            click.echo(f"  {one}")


if __name__ == "__main__":
    main()
