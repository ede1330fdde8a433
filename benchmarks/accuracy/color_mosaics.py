"""Colours of decoded mosaics beside bilinear demosaicing, on simulated pictures with truth.

    python -m benchmarks accuracy/color_mosaics [--device pocl] [--scene edges] [--array square]

Three scenes (saturated patches with sharp borders; fine threads of many colours; slow gradients
with highlights), each at several disparities and with what hides what, behind a hexagonal array
of 14.29 pixels (GRBG, turned by .6 degrees) and a square one of 13.37 (RGGB, -1.1 degrees): full
colour at every pixel of the sensor, vignetted, mosaicked, with photon and read noise of a full
well of 5000 electrons, 10 bits, and a white image of four such frames. Compared are the views
that lie a pixel inside a lenslet, two pixels off their borders, each colour scaled by one number
to fit the truth: PSNR of linear light and of sRGB (peak 1), and the mean CIEDE2000 difference.
"bilinear" divides the mosaic by the white image, interpolates the colours on the sensor, and
slices them by the same lattice, linearly or by cubic splines (whichever is better, in each
number); rows of hexagonal lattices are interpolated by the same cubic as clplen's.
"""

from __future__ import annotations

import warnings
from typing import Any

import click
import numpy as np
from reference_mosaics import (
    ARRAYS,
    BLACK,
    SCENES,
    Array2D,
    Layer,
    by_hand,
    captured,
    lattice_of,
    scores,
    truth,
)

from clplen import Device, decode_raw
from clplen.lightfield import LensletGrid

Values = np.ndarray[Any, Any]

def compare(array: Array2D, scene: list[Layer], device: Device) -> dict[str, list[float]]:
    """The scores of every way."""
    raw, white = captured(array, scene)
    lattice = lattice_of(array)
    found: dict[str, list[float]] = {}
    views: dict[str, Values] = {}
    for word in ("within", "after", "before"):
        more = {} if word == "within" else {"demosaic": word}  # the default is meant
        lf = decode_raw(
            raw.astype(np.float32) - BLACK, lattice, device=device, white=white - BLACK,
            bayer=array.bayer, **more,
        )  # fmt: skip
        views[word] = lf.to_numpy()
    assert lf.raw is not None
    grid = lf.raw.sub_images
    assert isinstance(grid, LensletGrid)
    true = truth(array, scene, grid)
    found = {word: scores(picture, true, array, grid) for word, picture in views.items()}
    both = [scores(by_hand(raw, white, array, grid, n), true, array, grid) for n in (1, 3)]
    found["bilinear"] = [max(pair) for pair in zip(*both, strict=True)]
    found["bilinear"][2] = min(pair[2] for pair in both)
    return found


@click.command()
@click.option("--device", "selector", help="As Device.open takes it.")
@click.option("--scene", "scenes", multiple=True, type=click.Choice(list(SCENES)))
@click.option("--array", "arrays", multiple=True, type=click.Choice(list(ARRAYS)))
def main(selector: str | None, scenes: tuple[str, ...], arrays: tuple[str, ...]) -> None:
    """Every scene behind every array."""
    warnings.simplefilter("ignore")
    device = Device.open(selector)
    click.echo(f"{device!r}\nPSNR linear, dB / PSNR sRGB, dB / CIEDE2000")
    worse = 0
    for name in arrays or ARRAYS:
        for scene in scenes or SCENES:
            found = compare(ARRAYS[name], SCENES[scene](ARRAYS[name]), device)
            click.echo(f"{name}, {scene}")
            for way, (linear, srgb, apart) in found.items():
                click.echo(f"  {way:<10} {linear:6.2f} / {srgb:6.2f} / {apart:5.2f}")
            mine, other = found["within"], found["bilinear"]
            worse += (mine[0] <= other[0]) + (mine[1] <= other[1]) + (mine[2] >= other[2])
    click.echo(f"clplen's default is worse than bilinear in {worse} numbers")

