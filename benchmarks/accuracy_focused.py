"""How right focused cameras are: spots, places, patches, depth, several lens types.

    python benchmarks/accuracy_focused.py [--device pocl] [--only spots,places,seams,...]

A line for each figure with its limit. By waves: 532 nm, f = 120 mm in 2f-2f, square lenslets of
150 um with 30 pixels; "several lens types" are hexagonal, three focal lengths. Independent of the
package are the Fresnel integrals of tests/reference_spots.py and the rays of
tests/reference_focused.py. About a minute in all.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from reference_spots import Rings, slope, spot, width
from setups_focused import captured, exposed, raw_of
from setups_slanted import Slanted, slanted

from clplen import Device, MicrolensArray, PlenopticCamera, PointSources, read_raw, render_focused
from clplen.cameras import Plenoptic2, scene_energy
from clplen.io import write_picture, write_raytrix
from clplen.lightfield import FocusedImage, focused_depth, point_m, seam

Row = tuple[str, float, str, bool]
PITCH = 150e-6
POINTS = [(0.0, 0.0), (1e-3, 0.5e-3), (-0.8e-3, 0.65e-3), (0.3e-3, -0.9e-3)]  # (x, y)
# m of one patch size for all of a picture
SINGLE = (0.15, 0.16, 0.17, 0.18, 0.19, 0.2, 0.21, 0.23, 0.26)


def within(name: str, found: float, most: float, unit: str = "") -> Row:
    """A figure that is at most so large, either sign."""
    return name, found, f"within {most:g}{unit}", abs(found) <= most


def between(name: str, found: float, low: float, high: float) -> Row:
    """A figure between two."""
    return name, found, f"{low:.3g} to {high:.3g}", low <= found <= high


def above(name: str, found: float, least: float) -> Row:
    """A figure above another one."""
    return name, found, f"above {least:.3g}", found > least


def camera_of(device: Device, m: float, f: float = 10e-3, count: int = 61) -> Plenoptic2:
    """Pupil match for lenslets of 10 mm, cone match for those of 3 mm."""
    return PlenopticCamera.type2(
        focal_length=0.12, mla=MicrolensArray(PITCH, f, count=count, fill="full"),
        wavelength=532e-9, pixels_per_lenslet=30, device=device, m=m,
        match="pupil" if f == 10e-3 else "cone",
    )  # fmt: skip


def spots(device: Device) -> Iterator[Row]:
    """A point in focus under lenslets of 10 mm: pitch, views, energy, width, places."""
    for m in (0.25, 0.1, 0.3, -0.3):
        camera = camera_of(device, m)
        name = f"f_mu = 10 mm, m = {m:g}: "
        image = camera.expose(PointSources((0, 0, 0))).to_numpy().astype(np.float64)
        centres = camera.mla.centres()[15:46, 15:46]
        found = [spot(image, camera, place, m) for place in (centres * (1 + m)).reshape(-1, 2)]
        energy = np.array([one for one, _ in found]).reshape(31, 31)
        at = np.array([place for _, place in found]).reshape(31, 31, 2)
        weight = np.where(energy > 0.05 * energy.max(), energy, 0)
        by_pitch = slope(weight, centres[..., 1], at[..., 1]) - 1
        yield within(name + "m by the pitch, %", 100 * (by_pitch / m - 1), 0.5 if m == 0.1 else 5)
        low, high = sorted((abs(1 / m), abs((1 + camera.a / camera.image_distance) / m)))
        row = energy[15]
        yield between(name + "views a row", int((row > row.max() / 2).sum()), low - 1, high + 1)
        _, at_array, at_sensor = scene_energy(camera, PointSources((0, 0, 0)))[0]
        yield within(name + "energy, array to sensor", at_sensor / at_array - 1, 1e-6)
        yield within(name + "energy, aperture to array", at_array - 1, 4e-3)
        middle = image[900:930, 900:930].sum(0)
        expected = 0.886 * camera.wavelength * camera.b / PITCH
        yield within(name + "spot width, %", 100 * (width(middle) * 5e-6 / expected - 1), 15)
        yield from _off_axis(camera, name)


def _off_axis(camera: Plenoptic2, name: str) -> Iterator[Row]:
    """Spots of a point off the axis, from the lenslet matrix, and with the rings of the blur."""
    place = (0.9e-3, -0.5e-3, 0.0)
    image = camera.expose(PointSources(place)).to_numpy().astype(np.float64)
    rings = Rings(camera, camera.image_of([place])[0, ::-1])
    lenses = rings.inside()
    chief = np.array([rings.chief(lens) for lens in lenses])
    found = np.array([spot(image, camera, at, camera.m)[1] for at in chief])
    off = np.abs(found - chief).max() / camera.pixel_pitch
    rays = f"{name}{len(lenses)} spots from the lenslet matrix alone, px"
    yield rays, float(off), "(rings at the blur's rim turn the wave)", True
    predicted = np.array([rings.spot(lens) for lens in lenses])
    off = np.abs(found - predicted).max() / camera.pixel_pitch
    yield within(name + "from the matrix and the rings, px", float(off), 0.1)


def places(device: Device) -> Iterator[Row]:
    """Four points through lenslets of 3 mm, m = 0.2: where pictures put them, and their m."""
    camera = camera_of(device, 0.2, 3e-3, 84)
    scene = [(x, y, 0.0) for x, y in POINTS]
    raw = camera.expose(PointSources(scene))
    true = camera.image_of(scene)[:, ::-1]
    for method, most in (("basic", 2.0), ("blended", 4.0)):
        picture = render_focused(raw, method=method)
        off = max(float(np.hypot(*(_found(picture, at) - at))) for at in true)
        yield within(f"f_mu = 3 mm, m = 0.2: places, {method}, um", 1e6 * off, most)
    for m in (0.1, 0.125, 0.158, 0.2, 0.25, 0.3):
        away = camera.array_distance - camera.b / m
        dz = camera.dz(camera.image_distance / away)
        found = point_m(camera.expose(PointSources((0, 0, dz)))).m
        yield within(f"f_mu = 3 mm, m = {m:g}: m by the pitch, %", 100 * (found / m - 1), 1.0)


def _found(picture: FocusedImage, near: Any) -> Any:
    """I^2 centroid (y, x) in metres about a place."""
    values, (y, x) = picture.to_numpy().astype(np.float64), picture.places()
    at = np.array(near)
    for _ in range(4):
        rows, columns = np.abs(y - at[0]) <= PITCH, np.abs(x - at[1]) <= PITCH
        part = values[np.ix_(rows, columns)] ** 2
        at = np.array([part.sum(1) @ y[rows], part.sum(0) @ x[columns]]) / part.sum()
    return at


def seams(device: Device) -> Iterator[Row]:
    """How patches of three sizes join; by rays."""
    rig, image, _ = exposed("square", 0.2)
    raw = raw_of(device, rig, image, m=0.2)
    for patch, low, high in ((5.2, 4, 99), (None, 0.7, 1.4), (6.0, 4, 99)):
        found = seam(render_focused(raw, method="basic", patch=patch))
        what = "mu = 5.58 px" if patch is None else f"{patch:g} px"
        also = " (m p/dx)" if patch == 6 else ""
        yield between(f"jump at the borders of patches of {what}{also}", found, low, high)


def rays(device: Device) -> Iterator[Row]:
    """Several lens types, 26 x 28 lenslets, m from 0.13 to 0.3 along x, by rays."""
    scene = slanted(device)
    raw, white = scene.by_rays(), scene.white()
    yield from _sharper(scene, raw, white, "slanted by rays: ")


def waves(device: Device) -> Iterator[Row]:
    """The same, 24 x 21 lenslets, m from 0.15 to 0.25, points and lines of points by waves."""
    scene = slanted(device, (0.15, 0.25), count=(24, 21), pixels=40)
    raw = scene.by_waves(points=100)
    yield from _sharper(scene, raw, None, "slanted by waves: ", lines=True)


def _sharper(
    scene: Slanted, raw: Any, white: Any, name: str, *, lines: bool = False
) -> Iterator[Row]:
    """Depth against exact depth, and edges against those of one patch size."""
    depth = focused_depth(raw, white=white)
    m, z, count = scene.rms(depth)
    yield within(name + f"rms of m, {count} lenslets, %", 100 * m, 4.0)
    yield within(name + "rms of z over the object's distance, %", 100 * z, 2.0)
    step = depth.geometry.pitch / 8

    def edges(**words: Any) -> Any:
        picture = render_focused(raw, white=white, step=step, **words)
        return scene.mtf50(picture, lines=lines)

    single = {
        (method, m): edges(method=method, m=m) for method in ("basic", "blended") for m in SINGLE
    }
    best = edges(method="depth", depth=depth)
    for how, of in (("mean", np.mean), ("least", np.min)):
        most, (method, at) = max((float(of(found)), key) for key, found in single.items())
        text = f"{name}MTF50 of edges, {how}, cycles/lenslet (best of one m: {method} {at:g})"
        yield above(text, float(of(best)), most)


def frame(device: Device) -> Iterator[Row]:
    """A frame with the XML of another geometry, as captured: 34.9 px, hexagonal, turned."""
    made = captured()
    with tempfile.TemporaryDirectory() as folder:
        xml = Path(folder, "shot.xml")
        write_raytrix(xml, made.calibration)
        pixels = np.round(made.image * 65535).astype(np.uint16)
        write_picture(xml.with_suffix(".tif"), pixels)
        raw = read_raw(xml, device=device)
    for name, white in (("no white image", None), ("a white image", made.white)):
        depth = focused_depth(raw, white=white)
        sure = depth.confidence >= depth.sure
        wrong = depth.m[sure] / made.ratio(depth.geometry.places)[sure] - 1
        rms = float(np.sqrt((wrong**2).mean()))
        yield within(f"captured, {name}: rms of m, {sure.sum()} lenslets, %", 100 * rms, 2.0)
    errors = {}
    for method, m in [("depth", None)] + [(w, m) for w in ("basic", "blended") for m in SINGLE]:
        words = {"depth": depth} if m is None else {"m": m}
        picture = render_focused(raw, method=method, white=made.white, step=5.0, **words)
        true = made.rig.picture(made.texture, *picture.grid.axes(), *made.plane)
        errors[method, m] = _wrong(picture.to_numpy() / 65535, true)
    best = errors.pop(("depth", None))
    yield within("captured: error of the picture, % of its contrast", 100 * best, 12.0)
    yield above("captured: that of the best single m", 100 * min(errors.values()), 100 * best)


def _wrong(found: Any, true: Any, border: int = 10) -> float:
    """rms difference over the contrast of the truth, without a border."""
    inside = np.s_[border:-border, border:-border]
    return float((found[inside] - true[inside]).std() / true[inside].std())


SECTIONS: dict[str, Callable[[Device], Iterator[Row]]] = {
    one.__name__: one for one in (spots, places, seams, rays, frame, waves)
}


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--only", default=",".join(SECTIONS), show_default=True)
def main(selector: str | None, only: str) -> None:
    """A table of figures and limits; ends with 1 where one is not met."""
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    met = True
    for name in only.split(","):
        for what, found, limit, is_met in SECTIONS[name](device):
            met &= is_met
            click.echo(f"{what:<88}{found:>11.4g}   {limit}{'' if is_met else '  NOT MET'}")
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
