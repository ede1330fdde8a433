"""OPD maps of a prescription by optiland: rays of many fields and wavelengths through a lens."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clplen import units
from clplen.cameras.optics.map_interpolation import require_room
from clplen.checks import install_advice, is_integer

Values = np.ndarray[Any, np.dtype[np.float64]]
MM = 1e-3  # optiland's lengths are in millimetres, its wavelengths in micrometres
SCALE_FIELD = 1e-4  # fraction of the largest field that defines the scale of the image
MAX_ASYMMETRY = 0.02  # maximum rms difference of a rotated field in wavelengths
FIELD_KINDS = ("AngleField", "ObjectHeightField", "ParaxialImageHeightField")


@dataclass
class _Rays:
    """Ray positions on the entrance pupil as fractions of its radius: optiland's distribution."""

    x: Values
    y: Values


def trace_maps(
    optic: Any, *, fields: int | Sequence[float], wavelengths: Sequence[float] | None, samples: int
) -> dict[str, Any]:
    """Return the arguments of `OPDMaps` for a lens; see `OPDMaps.traced`."""
    fractions, samples = _fractions(fields), _count(samples)
    lens = _Lens(_open_lens(optic))
    colours = lens.wavelengths() if wavelengths is None else _check_wavelengths(wavelengths)
    require_room(len(colours) * len(fractions) * samples**2)
    main = lens.primary() if wavelengths is None else float(colours[0])
    scale, axial = lens.scale(main), lens.wavefront(0.0, 0.0, main, samples)
    sign = axial.orientation()
    ideal = np.array([scale * lens.height(wavefront) for wavefront in fractions])
    if len(fractions) > 1:
        lens.require_symmetry(max(fractions), main, samples)
    shape = (len(colours), len(fractions))
    path, passed, edge = np.empty((3, *shape, samples, samples))
    displacement, pupil_shifts = np.zeros((2, *shape, 2))
    for n, colour in enumerate(colours):
        for k, fraction in enumerate(fractions):
            wavefront = lens.wavefront(0.0, fraction, colour, samples)
            for maps, table in (
                (path, wavefront.path),
                (passed, wavefront.passed),
                (edge, wavefront.edge),
            ):
                maps[n, k] = table[::sign, ::sign]
            displacement[n, k, 0] = wavefront.image[0] - ideal[k]
            pupil_shifts[n, k, 0] = wavefront.shift
    return {
        "path": path,
        "transmission": np.where(np.isfinite(path), passed, 0.0),
        "edge": edge if np.isfinite(edge).any() else None,
        "fields": np.stack([ideal, np.zeros_like(ideal)], axis=-1),
        "wavelengths": np.asarray(colours),
        "symmetric": len(fractions) > 1,
        "distortion": displacement,
        "pupil_shift": pupil_shifts,
        "pupil_distance": lens.pupil_distance,
        "pupil_diameter": 2 * lens.pupil_radius,
    }


@dataclass(frozen=True)
class _Wavefront:
    """Wavefront of a point: path in metres, transmission, edge, chief ray at image and pupil.

    ``rays`` pairs positions in the pupil with heights in the exit pupil, for its orientation.
    """

    path: Values
    passed: Values
    edge: Values
    image: tuple[float, float]
    shift: float
    rays: tuple[Values, Values]

    def orientation(self) -> int:
        """Return -1 for an inverted exit pupil, else 1."""
        return -1 if float(np.sum(self.rays[0] * self.rays[1])) < 0 else 1


class _Lens:
    """Queries to an optiland lens, in metres."""

    def __init__(self, optic: Any) -> None:
        self.optic = optic
        kind = type(optic.fields.field_definition).__name__
        if kind not in FIELD_KINDS:
            raise ValueError(
                "Fields of the lens must be angles, object heights or paraxial image heights, got "
                f"{kind}: change them in the prescription."
            )
        self.by_angle = kind == "AngleField"
        self.largest = float(optic.fields.max_field)
        distance = float(np.ravel(optic.paraxial.XPL())[0]) * MM
        self.pupil_radius = abs(float(np.ravel(optic.paraxial.XPD())[0])) * MM / 2
        self._pupil = distance  # exit pupil from the image plane, negative before it
        self.pupil_distance = abs(distance)

    def wavelengths(self) -> Values:
        """Return the wavelengths of the prescription."""
        return np.array([float(wavelength.value) * 1e-6 for wavelength in self.optic.wavelengths])

    def primary(self) -> float:
        """Return the prescription's primary wavelength."""
        return float(self.optic.primary_wavelength) * 1e-6

    def height(self, fraction: float) -> float:
        """Return the field coordinate of an ideal image: tangent of an angle, or height."""
        field = fraction * self.largest
        return math.tan(math.radians(field)) if self.by_angle else field * MM

    def scale(self, wavelength: float) -> float:
        """Return the image's height over `height`, next to the axis."""
        if self.largest == 0:
            return 0.0
        y, _ = self.chief(0.0, SCALE_FIELD, wavelength)[0]
        return y / self.height(SCALE_FIELD)

    def chief(self, across: float, up: float, wavelength: float) -> tuple[tuple[float, float], Any]:
        """Return (y, x) of a field's chief ray on the image, and in the exit pupil."""
        rays = self.optic.trace_generic(across, up, 0.0, 0.0, wavelength * 1e6)
        x, y, slope_x, slope_y, slope_z = (
            float(np.ravel(getattr(rays, name))[0]) for name in "xyLMN"
        )
        position = (y * MM, x * MM)
        steps = self._pupil / slope_z
        return position, (position[0] + steps * slope_y, position[1] + steps * slope_x)

    def wavefront(self, across: float, up: float, wavelength: float, samples: int) -> _Wavefront:
        """Trace the wavefront of a field."""
        from optiland.wavefront import Wavefront

        axis = np.linspace(-1, 1, samples)
        inside = np.hypot(axis[:, None], axis) <= 1 + 1e-12
        v, u = (np.broadcast_to(a, inside.shape)[inside] for a in (axis[:, None], axis))
        field, distribution = (across, up), _Rays(u, v)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # warnings about rays that miss a surface
            data = Wavefront(
                self.optic,
                fields=[field],
                wavelengths=[wavelength * 1e6],
                distribution=distribution,  # type: ignore[arg-type, unused-ignore]
            ).get_data(field, wavelength * 1e6)
            self.optic.trace(*field, wavelength * 1e6, None, distribution)
        waves, share, height = (
            np.asarray(values, np.float64) for values in (data.opd, data.intensity, data.pupil_y)
        )
        failed = (waves == 0) & (share == 0) & (height == 0) & (np.asarray(data.pupil_x) == 0)
        path, light, edge = np.full((3, *inside.shape), np.nan)
        path[inside] = np.where(failed, np.nan, -waves * wavelength)  # optiland's sign is opposite
        light[inside], edge[inside] = share, self._edges(share > 0)
        position, pupil = self.chief(across, up, wavelength)
        if not (share > 0).any():
            raise ValueError(
                f"No ray of the field at {up:g} of the largest passes the lens at "
                f"{units.metres(wavelength)}: use smaller fields."
            )
        return _Wavefront(
            path,
            light,
            edge,
            position,
            pupil[0] / self.pupil_radius,
            (v[~failed], height[~failed]),
        )

    def _edges(self, passes: Any) -> Values:
        """Return the smallest 1 - r/a of the last traced rays at the rims of all surfaces.

        NaN if a rim is not a circle about the axis.
        """
        out = np.full(passes.shape, np.nan)
        surfaces = self.optic.surfaces
        x, y = (np.asarray(getattr(surfaces, name), np.float64) for name in "xy")
        for number in range(len(x)):
            rim = surfaces[number].aperture
            if rim is None:
                continue
            if type(rim).__name__ != "RadialAperture" or rim.r_min:
                return np.full(passes.shape, np.nan)
            out = np.fmin(out, 1 - np.hypot(x[number], y[number]) / float(rim.r_max))
        edges = np.where(np.isnan(out), 1.0, out)  # other lost light is just outside the edge
        return np.where(passes, np.maximum(edges, 1e-9), np.where(edges < 0, edges, -0.05))

    def require_symmetry(self, fraction: float, wavelength: float, samples: int) -> None:
        """Raise for a lens whose light changes if the field is rotated by a right angle."""
        upright, turned = (
            self.wavefront(*field, wavelength, samples)
            for field in ((0.0, fraction), (fraction, 0.0))
        )
        both = np.isfinite(upright.path) & np.isfinite(turned.path.T)
        off = math.sqrt(float(np.mean((upright.path - turned.path.T)[both] ** 2)))
        moved = math.hypot(*(a - b for a, b in zip(upright.image, turned.image[::-1], strict=True)))
        if off > MAX_ASYMMETRY * wavelength or moved > 1e-6 * math.hypot(*upright.image):
            raise ValueError(
                "The lens must be rotationally symmetric, but the wavefront of its largest field "
                f"changes by {off / wavelength:.3g} waves rms if the field is rotated by 90 "
                "degrees: use OPDMaps(...) with fields spread over the image."
            )


def _open_lens(optic: Any) -> Any:
    """Return an optiland lens, read from its file if given."""
    try:
        import optiland.fileio as files
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"Tracing a lens requires optiland: {install_advice('lenses')}."
        ) from error
    if not isinstance(optic, str | os.PathLike):
        if not hasattr(optic, "trace_generic"):
            raise TypeError(
                f"optic must be an optiland Optic or a path, got {type(optic).__name__}."
            )
        return optic
    path = Path(optic)
    if not path.is_file():
        raise FileNotFoundError(f"No prescription found at {path}.")
    if path.suffix.lower() == ".json":
        return files.load_optiland_file(str(path))
    if path.suffix.lower() == ".zmx":
        return files.load_zemax_file(str(path))
    raise ValueError(f"A prescription must be optiland's .json or Zemax' .zmx, got {path}.")


def _fractions(fields: int | Sequence[float]) -> Values:
    if isinstance(fields, int | np.integer):
        if fields < 1:
            raise ValueError(
                f"fields must be a number >= 1, or fractions of the largest, got {fields!r}."
            )
        return np.linspace(0, 1, int(fields))
    fractions = np.asarray(fields, np.float64)
    if fractions.ndim != 1 or not len(fractions) or not ((fractions >= 0) & (fractions <= 1)).all():
        raise ValueError(f"fields must be fractions of the largest field, 0 to 1, got {fields!r}.")
    return fractions


def _count(samples: int) -> int:
    if not is_integer(samples) or samples < 5:
        raise ValueError(f"samples must be 5 or more along each axis of a map, got {samples!r}.")
    return int(samples)


def _check_wavelengths(wavelengths: Sequence[float]) -> Values:
    values = np.atleast_1d(np.asarray(wavelengths, np.float64))
    if values.ndim != 1 or not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(f"wavelengths must be positive, in metres, got {wavelengths!r}.")
    units.WAVELENGTH.check(values, "A wavelength")
    return values
