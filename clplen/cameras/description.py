"""Tables of a camera's derived parameters."""

from __future__ import annotations

import html
import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from clplen.cameras.optics.camera_aberrations import Aberrations
from clplen.cameras.optics.local_window import window_shape
from clplen.cameras.optics.opd_maps import OPDMaps
from clplen.cameras.optics.ray_optics import thin_spherical
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.reprs import OneLine


@dataclass(frozen=True)
class Row:
    """Derived parameter with its name, value in SI units, unit and meaning."""

    name: str
    value: float
    unit: str
    text: str


@dataclass(frozen=True, repr=False)
class Description(OneLine):
    """Derived parameters of a camera; prints as a table.

    Attributes
    ----------
    title : str
        Kind of the camera.
    rows : tuple of Row
        Derived parameters, each with its name, value in SI units, unit and meaning.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=15)
    >>> print(camera.describe())
    Plenoptic 1.0 camera
      focal length                 120 mm    main lens
      object distance              240 mm    focused plane to main lens
    ...
    >>> camera.describe()["views"]
    15
    """

    title: str
    rows: tuple[Row, ...]

    def __getitem__(self, name: str) -> float:
        """Return the value of a parameter in SI units."""
        for row in self.rows:
            if row.name == name:
                return row.value
        raise KeyError(f"no parameter {name!r}; use {', '.join(r.name for r in self.rows)}")

    def __str__(self) -> str:
        width = max(len(row.name) for row in self.rows)
        lines = [self.title]
        for row in self.rows:
            value, unit = _readable(row.value, row.unit)
            lines.append(f"  {row.name:<{width}}  {value:>10} {unit:<4}  {row.text}".rstrip())
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Return the table in HTML, for notebooks."""
        rows = [(row.name, *_readable(row.value, row.unit), row.text) for row in self.rows]
        cells = "".join(
            f"<tr>{''.join(f'<td>{html.escape(text)}</td>' for text in row)}</tr>" for row in rows
        )
        return f"<table><caption>{html.escape(self.title)}</caption>{cells}</table>"


class Described:
    """Mixin of cameras that describe themselves; shown as a table in notebooks."""

    @abstractmethod
    def describe(self) -> Description:
        """Return the derived parameters as a `Description`."""

    def _repr_html_(self) -> str:
        return self.describe()._repr_html_()


def _readable(value: float, unit: str) -> tuple[str, str]:
    """Return a length in m, mm, um or nm; other values unchanged."""
    if unit != "m" or value == 0:
        return f"{value:.6g}", unit
    for factor, name in ((1.0, "m"), (1e-3, "mm"), (1e-6, "um")):
        if abs(value) >= factor:
            return f"{value / factor:.6g}", name
    return f"{value * 1e9:.6g}", "nm"


def optics_rows(optics: WaveOptics) -> tuple[Row, ...]:
    """Return the rows of main lens, pixels, the window of a point in focus, and aberrations."""
    aberrated = aberration_rows(optics.aberrations, optics.wavelength)
    return (_main_lens(optics), *_pixels(optics), *_exposure(optics), *aberrated)


def _main_lens(optics: WaveOptics) -> Row:
    rim_path = thin_spherical(
        optics.aperture_diameter, optics.object_distance, optics.image_distance
    )
    model_texts = {
        "thin": "lens_model 'thin': included in the wave",
        "corrected": "removed by the lens_model in use, 'corrected'; the sine condition holds",
    }
    text = f"at the rim of a thin lens, {rim_path / optics.wavelength:.3g} waves; "
    return Row("spherical aberration", rim_path, "m", text + model_texts[optics.lens_model])


def _pixels(optics: WaveOptics) -> tuple[Row, ...]:
    pixels = optics.pixels
    if pixels is None:
        return (Row("active share", 0.0, "", "a pixel samples the intensity in its middle"),)
    rows = [
        Row(
            "active share",
            pixels.fill_factor,
            "",
            "fraction of a pixel's area that integrates light"
            if pixels.fill_factor
            else "a pixel samples the intensity in its middle",
        )
    ]
    down, right = pixels.offset
    offset_rows = (
        Row("sensor offset y", down, "m", "middle of the sensor from the axis"),
        Row("sensor offset x", right, "m", "middle of the sensor from the axis"),
        Row("sensor rotation", pixels.rotation, "rad", "rows of pixels against the lenslets"),
    )
    rows += [row for row in offset_rows if row.value]
    if pixels.crosstalk is not None:
        kernel = np.asarray(pixels.crosstalk)
        retained = float(kernel[kernel.shape[0] // 2, kernel.shape[1] // 2])
        rows.append(
            Row("pixel crosstalk", 1 - retained, "", "fraction of a pixel's light in neighbours")
        )
    return tuple(rows)


def _exposure(optics: WaveOptics) -> tuple[Row, ...]:
    """Return the samples, window and lost light of a point in focus on the axis.

    The share 2/(pi v) of an Airy pattern lies beyond v (Born and Wolf 1999, section 8.5.2).
    """
    if optics.pixels is None:
        finer, shape, pitch = 1, optics.grid.shape, optics.pixel_pitch
        reach = min(optics.grid.extent) / 2
        reason = "one field of the sensor's size ('points'): the pixels sample the light's waves"
    else:
        window = window_shape(optics, np.zeros(3))
        finer, shape, pitch = window.finer, (window.samples, window.samples), window.pitch
        reach = (window.samples / 2 - window.guard) * pitch
        reason = "a window for each point ('local'): the pixels integrate"
        if not optics.samples(np.zeros((1, 3))):
            reason += " and do not sample the light"
    v = math.pi * optics.aperture_diameter * reach / (optics.wavelength * optics.array_distance)
    size = f"{shape[0]} x {shape[1]} samples for a point in focus"
    return (
        Row("samples a pixel", finer, "", f"along each axis; {reason}"),
        Row("window", max(shape) * pitch, "m", size),
        Row("light beyond it", 2 / (math.pi * v), "", "fraction of the light, 2/(pi v)"),
    )


def aberration_rows(aberrations: Aberrations, wavelength: float) -> tuple[Row, ...]:
    """Return the rows of a camera's departures from its design."""
    scatter = aberrations.scatter
    rows = []
    for name, terms in (("main lens", aberrations.main_lens), ("lenslets", aberrations.lenslets)):
        rms = math.sqrt(sum(metres**2 for j, metres in terms if j > 1))
        text = f"rms over the disc, {rms / wavelength:.4g} waves"
        rows.append(Row(f"wavefront of {name}", rms, "m", text))
    grows = math.hypot(*(g for _, pair in aberrations.main_lens_field for g in pair))
    per_mm = f"rms over the disc, {grows / wavelength / 1e3:.4g} waves per mm of the image"
    rows.insert(1, Row("its growth over the field", grows, "", per_mm))
    if aberrations.main_lens_opd is not None:
        rows += _map_rows(aberrations.main_lens_opd, wavelength)
    rows += [
        Row("scatter of focal length", scatter.focal_length, "", "rms over the lenslets, of f"),
        Row("scatter of tilt", scatter.tilt, "rad", "rms over the lenslets, each axis"),
        Row("scatter of position", scatter.position, "m", "rms over the lenslets, each axis"),
        Row("sensor shift", aberrations.sensor_shift, "m", "away from the array"),
        Row("sensor tilt", math.hypot(*aberrations.sensor_tilt), "rad", "slope against the array"),
    ]
    return tuple(row for row in rows if row.value)


def _map_rows(maps: OPDMaps, wavelength: float) -> list[Row]:
    rms, share = maps.rms(wavelength)
    nearest = rms[np.hypot(*maps.fields.T).argmin()] / wavelength
    text = f"rms over the pupil of the worst field, {rms.max() / wavelength:.4g} waves"
    text += f"; nearest to the axis {nearest:.4g}"
    if maps.pupil_distance is not None and maps.pupil_diameter is not None:
        text += f"; maps of f/{maps.pupil_distance / maps.pupil_diameter:.4g}"
    distortion = maps.steepest(wavelength)[1]
    vignetting = 1 - float(share.min())
    return [
        Row("wavefront of OPD maps", float(rms.max()), "m", text),
        Row("distortion of OPD maps", distortion, "m", "largest displacement of the chief ray"),
        Row(
            "vignetting of OPD maps",
            vignetting,
            "",
            "lost light of the worst field",
        ),
    ]
