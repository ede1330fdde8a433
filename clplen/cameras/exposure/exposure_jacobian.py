"""Jacobian of a raw image: derivatives of its pixels by parameters of scene and camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clplen.cameras.exposure.pixel_signals import PixelSignals
from clplen.cameras.exposure.point_tangents import PointTangents, point_tangents
from clplen.cameras.exposure.scene_parts import SceneImages, SceneLine
from clplen.compute.memory import free_memory
from clplen.reprs import OneLine

Values = np.ndarray[Any, np.dtype[np.float64]]

GROUPS = ("values", "positions", "lenslets", "sensor")
LENSLET_IMAGES = 6  # derivative images of an array, plus an image for each kind of lenslet
SENSOR_IMAGES = 3  # derivative images of the sensor: shift, tilt along y and x


@dataclass(frozen=True, eq=False, repr=False)
class ExposureJacobian(OneLine):
    """Derivatives of a raw image with respect to parameters of scene and camera, float64.

    Attributes
    ----------
    image : numpy.ndarray
        Raw image, shape (ny, nx).
    values : numpy.ndarray or None
        Derivatives by the energies, shape ``(*in_shape, ny, nx)``.
    positions : numpy.ndarray or None
        Derivatives by (x, y, dz) of every point, per metre, shape (n, 3, ny, nx). Points have the
        order of ``operator.positions``.
    lenslets : dict of str to numpy.ndarray
        Derivatives by the array, per metre or radian: "pitch", "diameter", "rotation",
        "focal_length", shape (ny, nx); "offset" (y, x), (2, ny, nx); "focal_lengths" of each kind,
        (kinds, ny, nx).
    sensor : dict of str to numpy.ndarray
        Derivatives by the sensor: "shift" away from the array, per metre, shape (ny, nx); "tilt",
        slopes (y, x), (2, ny, nx).

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=15, aperture_diameter=0.5e-3)
    >>> operator = clplen.cameras.ExposureOperator(camera, clplen.PointSources((0, 0, -1e-3)))
    >>> jacobian = operator.jacobian([2.0], by=("values", "positions", "sensor"))
    >>> jacobian.positions.shape, jacobian.sensor["tilt"].shape
    ((1, 3, 75, 75), (2, 75, 75))
    >>> bool(np.allclose(2 * jacobian.values[0], jacobian.image))
    True
    """

    image: Values
    values: Values | None = None
    positions: Values | None = None
    lenslets: dict[str, Values] = field(default_factory=dict)
    sensor: dict[str, Values] = field(default_factory=dict)


def check_groups(by: Any) -> tuple[Any, ...]:
    """Return the checked names of groups of derivatives."""
    names = (by,) if isinstance(by, str) else tuple(by)
    wrong = [name for name in names if name not in GROUPS]
    if wrong or not names:
        raise ValueError(
            f"by must name at least one of {', '.join(map(repr, GROUPS))}, got {by!r}"
            + (f": {wrong[0]!r} is none of them." if wrong else ".")
        )
    return names


def exposure_jacobian(
    images: SceneImages, signals: PixelSignals, energies: Sequence[Values], by: Sequence[Any]
) -> ExposureJacobian:
    """Compute the Jacobian of all points of a scene."""
    _check_memory(images, signals.shape, by)
    shape, parts = signals.shape, images.parts
    image, shared = np.zeros(shape), dict[str, Values]()
    values = [np.zeros((p.indices.size, p.channels, *shape)) for p in parts if "values" in by]
    positions = [np.zeros((len(p.points), 3, *shape)) for p in parts if "positions" in by]
    for index, line in images.lines():
        for tangents in point_tangents(line.optics, parts[index].points, by):
            weights = (energies[index][tangents.indices] @ line.weights).T  # (filters, n)
            read = _signal_reader(signals, weights)
            image += read(tangents.images[None], True)[0]
            if values:
                values[index][tangents.indices] += _by_values(tangents, line, signals)
            if positions:
                changes = np.stack(
                    [read(derivative[:, None], False) for derivative in tangents.positions]
                )
                positions[index][tangents.indices] += np.moveaxis(changes, 0, 1)
            for name, change in tangents.shared.items():
                shared[name] = shared.get(name, 0.0) + read(change, True)
    return ExposureJacobian(
        image,
        _spread(images, values) if values else None,
        np.concatenate(positions) if positions else None,
        {
            name: _drop_scalar_axis(name, derivative)
            for name, derivative in shared.items()
            if name not in ("shift", "tilt")
        },
        {
            name: _drop_scalar_axis(name, derivative)
            for name, derivative in shared.items()
            if name in ("shift", "tilt")
        },
    )


def _signal_reader(signals: PixelSignals, weights: Values) -> Callable[[Values, bool], Values]:
    """Return a function that sums the pixels' signals of light (k, n, ny, nx) over the points."""

    def read(light: Values, together: bool) -> Values:
        if together:
            return signals.read_values(np.einsum("fn,knyx->fkyx", weights, light))
        return signals.read_values(weights[:, :, None, None] * light[:, 0])

    return read


def _by_values(tangents: PointTangents, line: SceneLine, signals: PixelSignals) -> Values:
    """Compute pixel signals of points for each channel, shape (n, channels, ny, nx)."""
    channels = [
        signals.read_values(share[:, None, None, None] * tangents.images) for share in line.weights
    ]
    return np.stack(channels, axis=1)


def _spread(images: SceneImages, values: Sequence[Values]) -> Values:
    """Return derivatives by all values of a scene, 0 for dark samples, shape (size, ny, nx)."""
    blocks = []
    for part, derivatives in zip(images.parts, values, strict=True):
        block = np.zeros((part.size // part.channels, *derivatives.shape[1:]))
        block[part.indices] = derivatives
        blocks.append(block.reshape(part.size, *derivatives.shape[2:]))
    return np.concatenate(blocks)


def _drop_scalar_axis(name: str, change: Values) -> Values:
    """Remove the axis of a scalar parameter."""
    return change if name in ("offset", "focal_lengths", "tilt") else change[0]


def _check_memory(images: SceneImages, shape: tuple[int, int], by: Sequence[Any]) -> None:
    columns = 1
    for part in images.parts:
        columns += part.size * ("values" in by) + 3 * len(part.points) * ("positions" in by)
    if "lenslets" in by:
        columns += LENSLET_IMAGES + len(images.parts[0].lines[0].optics.mla.focal_lengths)
    columns += SENSOR_IMAGES * ("sensor" in by)
    nbytes, free = 8 * columns * shape[0] * shape[1], free_memory()
    if nbytes > free:
        raise MemoryError(
            f"A Jacobian of {columns} images of {shape} pixels takes {nbytes / 2**30:.3g} GiB, but "
            f"{free / 2**30:.3g} GiB are free: use fewer points or groups of by=, or gradient(), "
            "which stores no images."
        )
