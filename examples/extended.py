"""Pictures before the standard plenoptic camera of 75 x 75 lenslets: figures 1.11 to 1.18 and 3.7.

The camera is that of section 1.5 (f = 120 mm in 2f and 2f, p = 150 um, f_mu = 10 mm, 532 nm), with
20 pixels a lenslet. Its lens turns pictures upside down: axes are drawn turned by 180 degrees.
"""

import warnings

import drawing
import numpy as np
from common import Run, number
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle, Wedge

from clplen import (
    LightField,
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    RawImage,
    SamplingWarning,
)
from clplen.cameras import Plenoptic1

SHARE = 0.75  # of the array that the picture's image fills; at the border pixels alias
SAMPLES = 3  # of the card, a lenslet
DEPTHS = {"N": -50e-3, "O": 0.0, "F": 50e-3}  # a letter near, one in focus and one far; dz
PLACES = (0.18, 0.5, 0.82)  # of the letters, in both directions
QUICK = "a camera of 25 x 25 lenslets of 14 pixels, sparse pictures"


def camera(run: Run, *, count: int = 75, pixels: int = 20) -> Plenoptic1:
    """The camera, or a smaller one."""
    count, pixels = (25, 14) if run.quick else (count, pixels)
    lenslets = MicrolensArray(150e-6, 10e-3, count=count, fill="full")
    return PlenopticCamera.type1(focal_length=0.120, mla=lenslets, wavelength=532e-9,
                                 pixels_per_lenslet=pixels, device=run.device)


def card(cam: Plenoptic1) -> PicturePlane:
    """A test card in the focused plane: no half of it looks like another."""
    wide = across(cam)
    figure, axes = _canvas(cam, SAMPLES)
    # A frame on one row of lenslets; their cells begin 2/3 of one from the upper left edges.
    for inset, face in ((0, "w"), (1, "k")):
        corner = ((inset + 2 / 3) / wide, (inset + 1 / 3) / wide)
        side = 1 - (2 * inset + 1) / wide
        axes.add_patch(Rectangle(corner, side, side, fc=face, lw=0))
    for n in range(12):
        axes.add_patch(Wedge((0.27, 0.72), 0.22, 30 * n, 30 * n + 15, fc="w", lw=0))
    _write(axes, "1.0", (0.735, 0.72), 0.27)
    left = 4 + 2 / 3
    for pitch, bars in ((6, 3), (4, 3), (3, 3), (2, 4)):  # lenslets
        for n in range(bars):
            axes.add_patch(Rectangle(((left + n * pitch) / wide, 0.27), pitch / 2 / wide, 0.15,
                                     fc="w", lw=0))
        left += bars * pitch
    for n in range(8):
        axes.add_patch(Rectangle((0.06 + 0.11 * n, 0.07), 0.111, 0.13, fc=str((n + 1) / 8), lw=0))
    return PicturePlane(_grey(figure), wide * cam.lenslet_pitch)


def letters(cam: Plenoptic1) -> list[PicturePlane]:
    """Three letters from the upper left to the lower right, each in a plane of its own."""
    planes = []
    for place, (letter, dz) in zip(PLACES, DEPTHS.items(), strict=True):
        figure, axes = _canvas(cam, 2)
        _write(axes, letter, (place, 0.947 - place), 0.3)  # a font's middle is below the capitals'
        scale = (cam.object_distance + dz) / cam.image_distance  # all of one size on the array
        planes.append(PicturePlane(_grey(figure), across(cam) * cam.lenslet_pitch * scale, dz))
    return planes


def expose(cam: Plenoptic1, scene: PicturePlane | list[PicturePlane]) -> RawImage:
    """The raw image, and how it was found."""
    with warnings.catch_warnings():  # pixels that hardly carry the light; renderings do not see it
        warnings.simplefilter("ignore", SamplingWarning)
        raw = cam.expose(scene)
    print(f"  {raw.exposure}")
    return raw


def ideal(cam: Plenoptic1, plane: PicturePlane) -> np.ndarray:
    """Energy on each lenslet's cell of a picture in focus, float64: geometry, Airy's blur, cells.

    Airy's pattern as its Fourier transform, 2/pi (arccos s - s sqrt(1 - s^2)), s = lam F f/D
    (Goodman 2005, eq. 6-31); every sample is a point.
    """
    p, cutoff = cam.lenslet_pitch, cam.aperture_diameter / (cam.wavelength * cam.image_distance)
    window = (cam.mla.count[0] + 2) * p
    f = np.arange(-int(cutoff * window), int(cutoff * window) + 1) / window
    scale = -cam.image_distance / (cam.object_distance + plane.z)
    there_y, there_x = (np.exp(-2j * np.pi * scale * np.outer(f, axis))
                        for axis in (plane.y, plane.x))
    s = np.minimum(np.hypot(f[:, None], f) / cutoff, 1)
    transfer = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))
    spectrum = there_y @ plane.image @ there_x.T * transfer * np.outer(*[np.sinc(f * p)] * 2)
    centres = (np.arange(cam.mla.count[0]) - (cam.mla.count[0] - 1) / 2) * p
    back = np.exp(2j * np.pi * np.outer(centres, f))
    return (back @ spectrum @ back.T).real * (p / window) ** 2


def like(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation coefficient of two images."""
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def compare(cam: Plenoptic1, plane: PicturePlane, rendering: np.ndarray) -> None:
    """Print how like the ideal image a rendering is, and an image that is turned."""
    expected = ideal(cam, plane)
    number("correlation with the lenslets' ideal image", like(expected, rendering), 1, 0.02)


def show(axes: Axes, values: np.ndarray, pitch: float, largest: float | None = None) -> AxesImage:
    """An image from 0 on, in mm from its middle, turned by 180 degrees."""
    right, top = (n * pitch * 500 for n in values.shape[::-1])
    drawn = drawing.show(axes, values, pitch, vmin=0, vmax=largest, interpolation="antialiased",
                         interpolation_stage="data")
    axes.set(xlim=(right, -right), ylim=(-top, top), xlabel="x / mm", ylabel="y / mm")
    return drawn


def show_object(axes: Axes, plane: PicturePlane) -> AxesImage:
    """A picture as it stands before the camera: y down."""
    axes.set(xlabel="x / mm", ylabel="y / mm", title="the object")
    return drawing.show(axes, plane.image, plane.pitch, vmin=0, interpolation="antialiased")


def mosaic(lf: LightField, rows: slice, columns: slice) -> np.ndarray:
    """Views side by side, each and all together turned by 180 degrees."""
    views = lf.to_numpy()[rows, columns, ::-1, ::-1][::-1, ::-1]
    lines = [np.concatenate(list(line), axis=1) for line in views]
    return np.concatenate(lines, axis=0)


def across(cam: Plenoptic1) -> int:
    """Lenslets across the picture's image."""
    return round(SHARE * cam.mla.count[0])


def _canvas(cam: Plenoptic1, samples: int) -> tuple[Figure, Axes]:
    """Black, so many samples for each lenslet; coordinates from 0 to 1, y up."""
    side = across(cam) * (samples if cam.mla.count[0] > 25 else 1) / 100
    figure = Figure(figsize=(side, side), dpi=100, facecolor="k")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    return figure, axes


def _write(axes: Axes, text: str, at: tuple[float, float], height: float) -> None:
    points = 72 * axes.figure.get_figheight() * height
    axes.text(*at, text, color="w", ha="center", va="center", weight="bold", size=points)


def _grey(figure: Figure) -> np.ndarray:
    """What is drawn, 0 to 1."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., 0] / 255
