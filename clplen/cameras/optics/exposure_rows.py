"""What a camera's description says of its main lens, its pixels and how points are exposed."""

from __future__ import annotations

import math

import numpy as np

from clplen.cameras.optics.lenslet_camera import Row
from clplen.cameras.optics.local_window import window_shape
from clplen.cameras.optics.ray_optics import thin_spherical
from clplen.cameras.optics.wave_optics import WaveOptics


def rows(optics: WaveOptics) -> tuple[Row, ...]:
    """Model of the main lens, pixels, and samples, window and error of a point in focus."""
    return (_main_lens(optics), *_pixels(optics), *_exposure(optics))


def _main_lens(optics: WaveOptics) -> Row:
    own = thin_spherical(optics.aperture_diameter, optics.object_distance, optics.image_distance)
    words = {
        "thin": "lens_model 'thin': it is in the wave",
        "corrected": "lens_model 'corrected': taken out, and the sine condition holds",
    }
    text = f"at the rim of a thin lens, {own / optics.wavelength:.3g} waves; "
    return Row("spherical aberration", own, "m", text + words[optics.lens_model])


def _pixels(optics: WaveOptics) -> tuple[Row, ...]:
    pixels = optics.pixels
    if pixels is None:
        return (Row("active share", 0.0, "", "a pixel takes the intensity in its middle"),)
    found = [
        Row(
            "active share",
            pixels.fill_factor,
            "",
            "of a pixel's area, on which it adds up the light"
            if pixels.fill_factor
            else "a pixel takes the intensity in its middle",
        )
    ]
    down, right = pixels.offset
    beside = (
        Row("sensor offset y", down, "m", "of its middle from the axis"),
        Row("sensor offset x", right, "m", "of its middle from the axis"),
        Row("sensor rotation", pixels.rotation, "rad", "of its rows against the lenslets"),
    )
    found += [row for row in beside if row.value]
    if pixels.crosstalk is not None:
        kernel = np.asarray(pixels.crosstalk)
        own = float(kernel[kernel.shape[0] // 2, kernel.shape[1] // 2])
        found.append(Row("pixel crosstalk", 1 - own, "", "of a pixel's light it does not read"))
    return tuple(found)


def _exposure(optics: WaveOptics) -> tuple[Row, ...]:
    """The window of a point in focus on the axis: which, why, and what light it leaves out.

    Of an Airy pattern 2/(pi v) of the light lies beyond rho, v = pi D rho/(lam z2):
    J0^2(v) + J1^2(v) far out (Born and Wolf 1999, section 8.5.2).
    """
    if optics.pixels is None:
        many, shape, pitch = 1, optics.grid.shape, optics.pixel_pitch
        reach = min(optics.grid.extent) / 2
        why = "one field as large as the sensor ('points'): the pixels sample the light's waves"
    else:
        window = window_shape(optics, np.zeros(3))
        many, shape, pitch = window.finer, (window.samples, window.samples), window.pitch
        reach = (window.samples / 2 - window.guard) * pitch
        why = "a window of its own for each point ('local'): the pixels integrate"
        if not optics.samples(np.zeros((1, 3))):
            why += " and do not sample the light"
    v = math.pi * optics.aperture_diameter * reach / (optics.wavelength * optics.array_distance)
    size = f"of a point in focus, {shape[0]} x {shape[1]} samples"
    return (
        Row("samples a pixel", many, "", f"along each axis; {why}"),
        Row("window", max(shape) * pitch, "m", size),
        Row("light beyond it", 2 / (math.pi * v), "", "its share, 2/(pi v)"),
    )
