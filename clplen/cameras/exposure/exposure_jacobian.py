"""The Jacobian of a raw image: derivatives of its pixels by what scene and camera are made of."""

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
OF_LENSLETS = 6  # images of the parameters that every array has, beside one a kind of lenslet
OF_SENSOR = 3


@dataclass(frozen=True, eq=False, repr=False)
class ExposureJacobian(OneLine):
    """Derivatives of a raw image by what a scene and a camera are made of, float64.

    Attributes
    ----------
    image : numpy.ndarray
        The raw image itself, shape (ny, nx).
    values : numpy.ndarray or None
        By the energies, shape ``(*in_shape, ny, nx)``.
    positions : numpy.ndarray or None
        By (x, y, dz) of every point, a metre, shape (n, 3, ny, nx). Points are in the order of
        ``operator.positions``.
    lenslets : dict of str to numpy.ndarray
        By the array, a metre or radian: "pitch", "diameter", "rotation", "focal_length", shape (ny,
        nx); "offset" (y, x), (2, ny, nx); "focal_lengths" of each kind, (kinds, ny, nx).
    sensor : dict of str to numpy.ndarray
        By the sensor: "shift", a metre away from the array, shape (ny, nx); "tilt", by its slopes
        (y, x), (2, ny, nx).

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
    """Names of groups of derivatives, checked."""
    names = (by,) if isinstance(by, str) else tuple(by)
    wrong = [name for name in names if name not in GROUPS]
    if wrong or not names:
        raise ValueError(
            f"A Jacobian is by some of {', '.join(map(repr, GROUPS))}; by={by!r} has "
            f"{repr(wrong[0]) if wrong else 'none of them'}."
        )
    return names


def exposure_jacobian(
    images: SceneImages, signals: PixelSignals, energies: Sequence[Values], by: Sequence[Any]
) -> ExposureJacobian:
    """The Jacobian of all points of a scene."""
    _check_memory(images, signals.shape, by)
    shape, parts = signals.shape, images.parts
    image, shared = np.zeros(shape), dict[str, Values]()
    values = [np.zeros((p.places.size, p.channels, *shape)) for p in parts if "values" in by]
    places = [np.zeros((len(p.points), 3, *shape)) for p in parts if "positions" in by]
    for index, line in images.lines():
        for found in point_tangents(line.optics, parts[index].points, by):
            weights = (energies[index][found.which] @ line.weights).T  # (filters, n)
            read = _reader(signals, weights)
            image += read(found.images[None], True)[0]
            if values:
                values[index][found.which] += _by_values(found, line, signals)
            if places:
                changes = np.stack([read(one[:, None], False) for one in found.positions])
                places[index][found.which] += np.moveaxis(changes, 0, 1)
            for name, change in found.shared.items():
                shared[name] = shared.get(name, 0.0) + read(change, True)
    return ExposureJacobian(
        image,
        _spread(images, values) if values else None,
        np.concatenate(places) if places else None,
        {name: _plain(name, one) for name, one in shared.items() if name not in ("shift", "tilt")},
        {name: _plain(name, one) for name, one in shared.items() if name in ("shift", "tilt")},
    )


def _reader(signals: PixelSignals, weights: Values) -> Callable[[Values, bool], Values]:
    """What pixels read of light (k, n, ny, nx), added over the points, or of (n, 1, ny, nx)."""

    def read(light: Values, together: bool) -> Values:
        if together:
            return signals.read_values(np.einsum("fn,knyx->fkyx", weights, light))
        return signals.read_values(weights[:, :, None, None] * light[:, 0])

    return read


def _by_values(found: PointTangents, line: SceneLine, signals: PixelSignals) -> Values:
    """Images of points as pixels read them, of each channel, shape (n, channels, ny, nx)."""
    each = [
        signals.read_values(share[:, None, None, None] * found.images) for share in line.weights
    ]
    return np.stack(each, axis=1)


def _spread(images: SceneImages, values: Sequence[Values]) -> Values:
    """By all values of all members, 0 for samples that stay dark, shape (size, ny, nx)."""
    whole = []
    for part, own in zip(images.parts, values, strict=True):
        every = np.zeros((part.size // part.channels, *own.shape[1:]))
        every[part.places] = own
        whole.append(every.reshape(part.size, *own.shape[2:]))
    return np.concatenate(whole)


def _plain(name: str, change: Values) -> Values:
    """Without the axis of a parameter that is one number."""
    return change if name in ("offset", "focal_lengths", "tilt") else change[0]


def _check_memory(images: SceneImages, shape: tuple[int, int], by: Sequence[Any]) -> None:
    columns = 1
    for part in images.parts:
        columns += part.size * ("values" in by) + 3 * len(part.points) * ("positions" in by)
    if "lenslets" in by:
        columns += OF_LENSLETS + len(images.parts[0].lines[0].optics.mla.focal_lengths)
    columns += OF_SENSOR * ("sensor" in by)
    nbytes, free = 8 * columns * shape[0] * shape[1], free_memory()
    if nbytes > free:
        raise MemoryError(
            f"A Jacobian of {columns} images of {shape} pixels takes {nbytes / 2**30:.3g} GiB, and "
            f"{free / 2**30:.3g} GiB are free: give fewer points, leave out groups of by=, or use "
            "gradient(), which keeps none."
        )
