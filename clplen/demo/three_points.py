"""The thesis' central experiment (section 1.5): three points before a plenoptic camera.

The parts are functions, so that examples can use them one by one; `run` does everything and
writes it into a folder.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from clplen import plot
from clplen.cameras.camera_base import scene_energy
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.cameras.standard_camera import Plenoptic1
from clplen.compute.device import Device
from clplen.files import replacing
from clplen.io import write_html, write_lightfield, write_picture, write_stack
from clplen.lightfield.depth.alpha_estimate import AlphaEstimate, estimate_alpha
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.refocusing.focal_stacks import FocalStack, refocus
from clplen.lightfield.stacks import focal_stack
from clplen.outputs import MARK
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.intensity import add_scaled

SOURCE_DIAMETER = 10e-6
POINTS = {"A": (-3e-3, -3e-3, -50e-3), "B": (0.0, 0.0, 0.0), "C": (3e-3, 3e-3, 50e-3)}
DEPTHS = (-50e-3, -25e-3, 25e-3, 50e-3)
THESIS_ALPHAS = (0.850, 0.925, 1.080, 1.105)  # its table of section 1.6, at DEPTHS
REFOCUS_ALPHAS = (0.7368, 1.0, 1.1724)
STACK_ALPHAS = (0.65, 1.25, 25)  # first, last, number of planes
METHODS = ("thesis", "energy", "compensated")
FILES = (  # that `run` writes
    "lightfield.h5", "raw.tif", "raw.png", "views.png", "rendering.png", "phase_space.png",
    "refocused.png", "stack.tif", "stack.png", "energy_curves.png", "alpha.png", "tables.txt",
    "demo.html",
)  # fmt: skip
STEPS = 6 + len(DEPTHS)  # of `run`


def camera(device: Device, *, count: int = 101) -> Plenoptic1:
    """Return the camera of section 1.5, at 532 nm."""
    lenslets = MicrolensArray(150e-6, 10e-3, count=count, fill="full")
    return PlenopticCamera.type1(
        focal_length=0.120, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=30, device=device
    )


def expose_point(cam: Plenoptic1, position: Sequence[float]) -> RawImage:
    """Return the raw image of one source of 10 um at (x, y, dz) in metres."""
    return cam.expose(PointSources([position], diameter=SOURCE_DIAMETER))


def scene(cam: Plenoptic1) -> RawImage:
    """Return the sum of the raw images of A, B and C, each divided by its energy."""
    total = cam.device.zeros(cam.grid.shape, np.float32)
    for position in POINTS.values():
        raw = expose_point(cam, position)
        with cam.device.on_host(raw.data, write=False) as values:
            energy = float(values.sum(dtype=np.float64))
        add_scaled(total, raw.data, 1 / energy, cam.device)
    return replace(raw, data=total)


def array_position(cam: Plenoptic1, name: str) -> tuple[float, float]:
    """Return the image (x, y) of a point on the array, in lenslets counted from 0."""
    centre = np.array([(n - 1) / 2 for n in cam.mla.count[::-1]])
    x, y = centre + cam.image_of(POINTS[name])[0] / cam.lenslet_pitch
    return float(x), float(y)


def estimates(cam: Plenoptic1, dz: float) -> dict[str, AlphaEstimate]:
    """Estimate alpha of a point on the axis at dz by every method."""
    lf = LightField.from_raw(expose_point(cam, (0.0, 0.0, dz)))
    return {method: estimate_alpha(lf, method=method) for method in METHODS}


def energy_table(cam: Plenoptic1, lf: LightField) -> str:
    """Return the energy of A, B and C at the aperture, the array and the sensor as a table."""
    positions = list(POINTS.values())
    rows = scene_energy(cam, PointSources(positions, diameter=SOURCE_DIAMETER))
    lines = ["Energy", "  point   aperture      array     sensor"]
    for name, (aperture, at_array, at_sensor) in zip(POINTS, rows, strict=True):
        lines.append(f"  {name:5}  {aperture:9.5f}  {at_array:9.5f}  {at_sensor:9.5f}")
    share = float(lf.to_numpy().sum(dtype=np.float64)) / len(POINTS)
    lines.append(
        f"  The calibrated decode keeps {100 * share:.1f} % of the raw image: {lf.shape[0]} of "
        f"{lf.shape[0] * (1 + cam.lenslet_focal_length / cam.image_distance):.2f} pixels a view."
    )
    return "\n".join(lines)


def alpha_table(cam: Plenoptic1, by_depth: Sequence[dict[str, AlphaEstimate]]) -> str:
    """Return the estimated and the true alphas at `DEPTHS` as a table."""
    lines = [
        "Depth from focus, points on the axis",
        "    dz mm | true alpha | thesis' own | thesis method | compensated |   error",
    ]
    for dz, printed, methods in zip(DEPTHS, THESIS_ALPHAS, by_depth, strict=True):
        true, best = cam.alpha(dz), methods["compensated"].alpha
        lines.append(
            f"  {dz * 1e3:+7.0f} | {true:10.4f} | {printed:11.3f} | "
            f"{methods['thesis'].alpha:13.3f} | {best:11.4f} | {best - true:+7.4f}"
        )
    return "\n".join(lines)


def run(
    folder: Path,
    device: Device,
    *,
    say: Callable[[str], None],
    step: Callable[[str], None],
    count: int = 101,
) -> None:
    """Simulate everything and write tables, pictures and data.

    The tables are in ``tables.txt`` too, the light field in ``lightfield.h5``.
    """
    tables: list[str] = []

    def show(table: str) -> None:
        tables.append(table)
        say(table)

    cam = camera(device, count=count)
    show(str(cam.describe()))
    step("three points")
    raw = scene(cam)
    lf = LightField.from_raw(raw)
    write_lightfield(folder / "lightfield.h5", lf)
    step("energy")
    show(energy_table(cam, lf))
    step("pictures")
    _write_pictures(folder, cam, raw, lf)
    step("focal stack")
    stack = _write_stack(folder, cam, lf)
    step("page")
    subjects = {"light field": lf, "focal stack": stack}
    write_html(folder / "demo.html", subjects, title="Three points before a plenoptic camera")
    by_depth = []
    for dz in DEPTHS:
        step(f"point at {_mm(dz)}")
        by_depth.append(estimates(cam, dz))
    show(alpha_table(cam, by_depth))
    step("depth figures")
    _write_estimates(folder, cam, by_depth)
    with replacing(folder / "tables.txt") as temporary:
        temporary.write_text("\n\n".join([*tables, f"{MARK}."]) + "\n", encoding="utf-8")


def _write_pictures(folder: Path, cam: Plenoptic1, raw: RawImage, lf: LightField) -> None:
    """Write the raw image, views, rendering and phase space."""
    write_picture(folder / "raw.tif", raw.to_numpy(), description="energy a pixel, linear")
    magnified = 1 + cam.lenslet_focal_length / cam.image_distance
    images = (cam.image_of(position)[0] * magnified for position in POINTS.values())
    details = {name: (float(y), float(x)) for name, (x, y) in zip(POINTS, images, strict=True)}
    plot.save(plot.raw_image(raw, details=details), folder / "raw.png")
    region = _region(cam)
    plot.save(plot.views(lf, max_views=6, scale="log", region=region), folder / "views.png")
    rendering = plot.picture(lf.render(), title="rendering, all views", scale="log")
    plot.save(rendering, folder / "rendering.png")
    labels, rows, truths = [], [], []
    for name, (_, _, dz) in POINTS.items():
        labels.append(rf"{name}: dz = {_mm(dz)}, $\alpha$ = {cam.alpha(dz):.4f}")
        rows.append(round(array_position(cam, name)[1]))
        truths.append(cam.alpha(dz))
    slices = plot.phase_space(lf, rows=rows, labels=labels, truths=truths)
    plot.save(slices, folder / "phase_space.png")


def _write_stack(folder: Path, cam: Plenoptic1, lf: LightField) -> FocalStack:
    """Write the refocused pictures and the focal stack; return the stack."""
    images = [refocus(lf, alpha=alpha) for alpha in REFOCUS_ALPHAS]
    titles = [
        rf"$\alpha$ = {alpha:.4f}: {name} in focus"
        for name, alpha in zip(POINTS, REFOCUS_ALPHAS, strict=True)
    ]
    region = _region(cam)
    triplet = plot.refocused(images, titles, scale="log", region=region)
    plot.save(triplet, folder / "refocused.png")
    stack = focal_stack(lf, alphas=np.linspace(*STACK_ALPHAS))
    write_stack(folder / "stack.tif", stack)
    plot.save(plot.montage(stack, scale="log", region=region), folder / "stack.png")
    return stack


def _region(cam: Plenoptic1) -> tuple[slice, slice]:
    """Return the part of a view that holds all three points and their blur."""
    positions = np.array([array_position(cam, name) for name in POINTS])
    low, high = positions.min() - 12, positions.max() + 12
    part = slice(max(0, round(low)), min(cam.mla.count[0], round(high)))
    return (part, part)


def _write_estimates(
    folder: Path, cam: Plenoptic1, by_depth: Sequence[dict[str, AlphaEstimate]]
) -> None:
    """Write the curves E(alpha), and the estimates on alpha(dz)."""
    groups = {
        f"method {method!r}": [
            (_mm(dz), methods[method], cam.alpha(dz))
            for dz, methods in zip(DEPTHS, by_depth, strict=True)
        ]
        for method in METHODS
    }
    plot.save(plot.energy_curves(groups), folder / "energy_curves.png")
    estimated = {"the thesis' own": _points(THESIS_ALPHAS)} | {
        f"method {method!r}": _points(methods[method].alpha for methods in by_depth)
        for method in METHODS
    }
    plot.save(plot.alpha_curve(cam, estimated, reach=0.1), folder / "alpha.png")


def _mm(dz: float) -> str:
    return f"{dz * 1e3:+.0f} mm" if dz else "0 mm"


def _points(alphas: Iterable[float]) -> list[tuple[float, float]]:
    return list(zip(DEPTHS, alphas, strict=True))
