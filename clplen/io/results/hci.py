"""Parameters and true disparity of scenes of the HCI 4D benchmark.

Disparity from depth, all lengths in the same unit (Honauer, Johannsen, Kondermann, Goldluecke 2016,
"A dataset and evaluation methodology for depth estimation on 4D light fields", supplement):

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
_MAX_FILE_BYTES = 1 << 20
_MAX_PLANES = 10**6
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
    """Parameters in ``parameters.cfg`` of a scene; None for missing values.

    Attributes
    ----------
    focal_length_mm, sensor_size_mm, baseline_mm, focus_distance_m, fstop : float or None
        Lengths in the unit of the name, and the f-number.
    image_resolution_x_px, image_resolution_y_px, num_cams_x, num_cams_y : int or None
        Number of pixels in a view and number of views, along x and y.
    disp_min, disp_max : float or None
        Range of the disparity in pixels per view step.
    depth_map_scale : float or None
        Ratio of the size of the high-resolution maps to that of the views.
    scene, category : str or None
        Name of the scene and of its part of the benchmark.

    Examples
    --------
    The metric form (A3) is d = kappa F (1/z - 1/z0). For a camera with view step b, image distance
    F = f and pixel size dx = s / W on the sensor, kappa = b / dx:

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
        """Return the disparity of a depth.

        Parameters
        ----------
        Z_m : array_like
            Distance from the cameras along their axis, in metres; 0 gives infinity.

        Returns
        -------
        numpy.ndarray
            Disparity in pixels per view step, float64, larger when nearer.

        Raises
        ------
        ValueError
            If a required parameter is missing.
        """
        scale, focus_disparity = self._scale()
        with np.errstate(divide="ignore"):
            return np.asarray(scale / (1e3 * float64_array(Z_m)) - focus_disparity)

    def depth(self, d: ArrayLike) -> Array:
        """Return the depth of a disparity, the inverse of `disparity`.

        Parameters
        ----------
        d : array_like
            Disparity in pixels per view step.

        Returns
        -------
        numpy.ndarray
            Depth in metres, float64; infinite if no depth in front of the cameras fits.

        Raises
        ------
        ValueError
            If a required parameter is missing.
        """
        scale, focus_disparity = self._scale()
        inverse = float64_array(d) + focus_disparity
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(inverse > 0, 1e-3 * scale / np.abs(inverse), np.inf))

    def planes(self, step: float = 0.1) -> Array:
        """Return equidistant disparities over the range of the scene.

        Parameters
        ----------
        step : float
            Largest distance of neighbouring planes in pixels per view step, positive.

        Returns
        -------
        numpy.ndarray
            Disparities from ``disp_min`` to ``disp_max``, float64.

        Raises
        ------
        ValueError
                If the range is unknown or empty, or the step is not positive.
        """
        if self.disp_min is None or self.disp_max is None or not self.disp_min < self.disp_max:
            raise ValueError(
                f"disp_min must be less than disp_max, got {self.disp_min} and {self.disp_max}: "
                "give the planes explicitly."
            )
        count = (self.disp_max - self.disp_min) / step if step > 0 else math.inf
        if not count < _MAX_PLANES:
            raise ValueError(
                f"step must be positive and give less than a million planes, got {step}."
            )
        return np.linspace(self.disp_min, self.disp_max, math.ceil(round(count, 9)) + 1)

    def _scale(self) -> tuple[float, float]:
        """Return b f W / s in mm px, and the disparity b f W / (Z0 s) of the focus distance."""
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
                + ": add them to the parameters."
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
        Folder of the scene, or its ``parameters.cfg``.

    Returns
    -------
    HciParameters
        Values of the file; None for missing values.

    Raises
    ------
    FormatError
        If the file is missing or not an INI file, or if a value is invalid.

    Examples
    --------
    >>> parameters = clplen.io.HciParameters(
    ...     focal_length_mm=100.0, sensor_size_mm=35.0, baseline_mm=45.0, focus_distance_m=8.0,
    ...     image_resolution_x_px=512, image_resolution_y_px=512)
    >>> clplen.io.write_parameters("parameters.cfg", parameters)
    >>> stored = clplen.io.read_parameters("parameters.cfg")
    >>> stored.baseline_mm, f"{float(stored.disparity(7.0)):.4f} pixels a view step at 7 m"
    (45.0, '1.1755 pixels a view step at 7 m')
    """
    path = Path(path)
    file = path / _FILE if path.is_dir() else path
    if not file.is_file():
        raise FormatError(
            f"There is no file {file}; some scenes of the benchmark have no parameters."
        )
    if file.stat().st_size > _MAX_FILE_BYTES:
        raise FormatError(f"{file} is too large to be a file of parameters.")
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(file.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, configparser.Error) as error:
        reason = (str(error).splitlines() or [""])[0]
        raise FormatError(f"{file} is not a readable INI file ({reason[:200]}).") from error
    texts: dict[str, str] = {}
    for section in _SECTIONS:
        if parser.has_section(section):
            texts |= dict(parser.items(section))
    if not texts:
        raise FormatError(f"{file} has none of the sections {', '.join(_SECTIONS)}.")
    return HciParameters(
        **{
            field.name: _value(file, field.name, str(field.type), texts[field.name])
            for field in fields(HciParameters)
            if texts.get(field.name, "").strip()
        }
    )


def write_parameters(path: PathLike, parameters: HciParameters) -> None:
    """Write the parameters of a scene in the format of the HCI 4D benchmark.

    Parameters
    ----------
    path : path-like
        Folder of the scene, for a ``parameters.cfg`` in it, or the file itself.
    parameters : HciParameters
        Parameters to write; None values are left out.

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
    """Return the value of a parameter, converted by its annotation."""
    if kind.startswith("str"):
        return text.strip()
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    signed = name.startswith("disp_")
    is_integer = kind.startswith("int")
    if not fits_float64(number) or (number <= 0 and not signed) or (is_integer and number % 1):
        expected = (
            "a number" if signed else "a positive integer" if is_integer else "a positive number"
        )
        raise FormatError(f"{file}: {name} must be {expected}, got {text.strip()[:40]!r}.")
    return int(number) if is_integer else number


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
        raise FormatError(
            f"A disparity map must have shape (y, x), got {values.shape} from {path}."
        )
    return values.astype(np.float32)
