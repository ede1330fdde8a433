"""What the HCI 4D benchmark stores beside the views of a scene: parameters and true disparity.

Disparity from depth, all lengths in one unit (design of the benchmark: Honauer, Johannsen,
Kondermann, Goldluecke 2016, "A dataset and evaluation methodology for depth estimation on 4D light
fields", supplement):

    d = (b f W / Z - b f W / Z0) / s

with the baseline b, the focal length f, the larger pixel count W, the sensor size s and the focus
distance Z0.
"""

from __future__ import annotations

import configparser
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import check_finite, fits_float64, float64_array
from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.io.formats.pfm import read_pfm
from clplen.outputs import MARK
from clplen.reprs import OneLine

Array = np.ndarray[Any, np.dtype[np.float64]]

_FILE = "parameters.cfg"
_LARGEST = 1 << 20  # bytes
_MOST_PLANES = 10**6
_SECTIONS = {
    "intrinsics": (
        "focal_length_mm",
        "image_resolution_x_px",
        "image_resolution_y_px",
        "sensor_size_mm",
        "fstop",
    ),
    "extrinsics": ("num_cams_x", "num_cams_y", "baseline_mm", "focus_distance_m"),
    "meta": ("scene", "category", "disp_min", "disp_max", "depth_map_scale"),
}


@dataclass(frozen=True, repr=False)
class HciParameters(OneLine):
    """The ``parameters.cfg`` of a scene; None for what it does not say.

    Attributes
    ----------
    focal_length_mm, sensor_size_mm, baseline_mm, focus_distance_m, fstop : float or None
        Lengths in the unit that the name ends with, and the f-number.
    image_resolution_x_px, image_resolution_y_px, num_cams_x, num_cams_y : int or None
        Pixels of a view, and numbers of views, along x and y.
    disp_min, disp_max : float or None
        Range of the disparity in pixels a view step.
    depth_map_scale : float or None
        Size of the high-resolution maps over that of the views.
    scene, category : str or None
        Names of the scene and of the part of the benchmark that it belongs to.

    Examples
    --------
    The metric form is (A3), d = kappa F (1/z - 1/z0), of a camera with the step b between views,
    image distance F = f and pixels dx = s / W on the sensor, so that kappa = b / dx:

    >>> p = clplen.io.HciParameters(
    ...     focal_length_mm=100, sensor_size_mm=35, baseline_mm=45, focus_distance_m=8,
    ...     image_resolution_x_px=512, image_resolution_y_px=512)
    >>> du, F, dx = 45e-3, 100e-3, 35e-3 / 512
    >>> kappa = du / dx
    >>> z = 7.25
    >>> bool(abs(p.disparity(z) - kappa * F * (1 / z - 1 / 8)) < 1e-4)
    True
    >>> round(float(p.disparity(7.0)), 4), round(float(p.depth(p.disparity(7.0))), 4)
    (1.1755, 7.0)
    """

    focal_length_mm: float | None = None
    sensor_size_mm: float | None = None
    fstop: float | None = None
    image_resolution_x_px: int | None = None
    image_resolution_y_px: int | None = None
    num_cams_x: int | None = None
    num_cams_y: int | None = None
    baseline_mm: float | None = None
    focus_distance_m: float | None = None
    disp_min: float | None = None
    disp_max: float | None = None
    depth_map_scale: float | None = None
    scene: str | None = None
    category: str | None = None

    def disparity(self, Z_m: ArrayLike) -> Array:
        """Disparity of a depth.

        Parameters
        ----------
        Z_m : array_like
            Distance from the cameras along their axis, in metres; 0 gives infinity.

        Returns
        -------
        numpy.ndarray
            float64, pixels a view step, nearer larger.

        Raises
        ------
        ValueError
            If a parameter that it needs is not known.
        """
        scale, focused = self._scale()
        with np.errstate(divide="ignore"):
            return np.asarray(scale / (1e3 * float64_array(Z_m)) - focused)

    def depth(self, d: ArrayLike) -> Array:
        """The inverse of `disparity`.

        Parameters
        ----------
        d : array_like
            Disparity in pixels a view step.

        Returns
        -------
        numpy.ndarray
            float64, metres; infinite where no depth in front of the cameras has this disparity.

        Raises
        ------
        ValueError
            If a parameter that it needs is not known.
        """
        scale, focused = self._scale()
        inverse = float64_array(d) + focused
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(inverse > 0, 1e-3 * scale / np.abs(inverse), np.inf))

    def planes(self, step: float = 0.1) -> Array:
        """Disparities over the range of the scene.

        Parameters
        ----------
        step : float
            Positive; the planes lie at most this far from each other, in pixels a view step.

        Returns
        -------
        numpy.ndarray
            float64, from ``disp_min`` to ``disp_max``.

        Raises
        ------
        ValueError
            If the range is not known or empty, or the step not positive.
        """
        if self.disp_min is None or self.disp_max is None or not self.disp_min < self.disp_max:
            raise ValueError(
                f"The parameters give disp_min={self.disp_min} and disp_max={self.disp_max}, no "
                "range of disparity: give the planes yourself."
            )
        count = (self.disp_max - self.disp_min) / step if step > 0 else math.inf
        if not count < _MOST_PLANES:
            raise ValueError(f"step={step} is not positive, or gives a million planes and more.")
        return np.linspace(self.disp_min, self.disp_max, math.ceil(round(count, 9)) + 1)

    def _scale(self) -> tuple[float, float]:
        """b f W / s in mm px, and the disparity b f W / (Z0 s) that is taken off."""
        lengths = {
            name: getattr(self, name)
            for name in ("baseline_mm", "focal_length_mm", "sensor_size_mm", "focus_distance_m")
        }
        sizes = (self.image_resolution_x_px or 0, self.image_resolution_y_px or 0)
        missing = [name for name, value in lengths.items() if not value]
        if missing or not max(sizes):
            raise ValueError(
                "Depth in metres needs "
                + ", ".join(missing or ["image_resolution_x_px"])
                + ", which the parameters do not give."
            )
        check_finite(**lengths, sizes=sizes)
        scale = lengths["baseline_mm"] * lengths["focal_length_mm"] * max(sizes)
        scale /= lengths["sensor_size_mm"]
        return scale, scale / (1e3 * lengths["focus_distance_m"])


def read_parameters(path: PathLike) -> HciParameters:
    """Read the parameters of a scene of the HCI 4D benchmark.

    Parameters
    ----------
    path : path-like
        The folder of the scene, or its ``parameters.cfg``.

    Returns
    -------
    HciParameters
        The values of the file; None for what it does not say.

    Raises
    ------
    FormatError
        If there is none, it is no INI file, or a value is no number or out of range.

    Examples
    --------
    >>> parameters = clplen.io.HciParameters(
    ...     focal_length_mm=100.0, sensor_size_mm=35.0, baseline_mm=45.0, focus_distance_m=8.0,
    ...     image_resolution_x_px=512, image_resolution_y_px=512)
    >>> clplen.io.write_parameters("parameters.cfg", parameters)
    >>> found = clplen.io.read_parameters("parameters.cfg")
    >>> found.baseline_mm, f"{float(found.disparity(7.0)):.4f} pixels a view step at 7 m"
    (45.0, '1.1755 pixels a view step at 7 m')
    """
    path = Path(path)
    file = path / _FILE if path.is_dir() else path
    if not file.is_file():
        raise FormatError(
            f"There are no parameters {file}; some scenes of the benchmark lack them."
        )
    if file.stat().st_size > _LARGEST:
        raise FormatError(f"{file} is too large for a file of parameters.")
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(file.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, configparser.Error) as error:
        reason = (str(error).splitlines() or [""])[0]
        raise FormatError(f"{file} is no INI file that can be read ({reason[:200]}).") from error
    found: dict[str, str] = {}
    for section in _SECTIONS:
        if parser.has_section(section):
            found |= dict(parser.items(section))
    if not found:
        raise FormatError(f"{file} has none of the sections {', '.join(_SECTIONS)}.")
    return HciParameters(
        **{
            field.name: _value(file, field.name, str(field.type), found[field.name])
            for field in fields(HciParameters)
            if found.get(field.name, "").strip()
        }
    )


def write_parameters(path: PathLike, parameters: HciParameters) -> None:
    """Write the parameters of a scene as the HCI 4D benchmark does.

    Parameters
    ----------
    path : path-like
        The folder of the scene, which gets a ``parameters.cfg``, or the file itself.
    parameters : HciParameters
        What is None is left out.

    Raises
    ------
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> parameters = clplen.io.HciParameters(
    ...     focal_length_mm=100.0, sensor_size_mm=35.0, baseline_mm=45.0, focus_distance_m=8.0,
    ...     image_resolution_x_px=512, image_resolution_y_px=512)
    >>> clplen.io.write_parameters("parameters.cfg", parameters)
    >>> clplen.io.read_parameters("parameters.cfg") == parameters
    True
    """
    parser = configparser.ConfigParser(interpolation=None)
    for section, names in _SECTIONS.items():
        values = {name: getattr(parameters, name) for name in names}
        parser[section] = {name: str(value) for name, value in values.items() if value is not None}
    target = Path(path)
    file = target / _FILE if target.is_dir() else target
    with replacing(file) as temporary, temporary.open("w", encoding="utf-8") as stream:
        parser.write(stream)
        stream.write(f"# {MARK}\n")


def _value(file: Path, name: str, kind: str, text: str) -> Any:
    """A value of a parameter by its annotation."""
    if kind.startswith("str"):
        return text.strip()
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    signed = name.startswith("disp_")
    whole = kind.startswith("int")
    if not fits_float64(number) or (number <= 0 and not signed) or (whole and number % 1):
        wanted = (
            "a number" if signed else "a positive whole number" if whole else "a positive number"
        )
        raise FormatError(f"{file}: {name} is {text.strip()[:40]!r}, not {wanted}.")
    return int(number) if whole else number


def read_truth(folder: PathLike, *, high: bool = False) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Read the true disparity of the centre view of a scene of the HCI 4D benchmark."""
    folder = Path(folder)
    size = "highres" if high else "lowres"
    disparity, depth = (folder / f"gt_{what}_{size}.pfm" for what in ("disp", "depth"))
    if disparity.is_file():
        return _map(disparity)
    if not depth.is_file():
        raise FormatError(f"There is no true disparity in {folder}: {disparity.name} is missing.")
    parameters = read_parameters(folder)
    try:
        return parameters.disparity(_map(depth)).astype(np.float32)
    except ValueError as error:
        raise FormatError(f"{folder / _FILE}: {error}") from error


def _map(path: Path) -> np.ndarray[Any, np.dtype[np.float32]]:
    values = read_pfm(path)
    if values.ndim != 2:
        raise FormatError(f"{path} has shape {values.shape}; a disparity map has (y, x).")
    return values.astype(np.float32)
