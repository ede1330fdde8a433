"""Cameras behind an objective with its tube lens: light of fluorescent points in batches."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from typing import Any

import numpy as np

from clplen.cameras.optics.objective import CoverGlass, Objective
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.device import Device
from clplen.wave.coherence.averaging import Progress
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import accumulate
from clplen.wave.propagation.free_space import plan
from clplen.wave.propagation.propagator import Propagator

Vector = np.ndarray[Any, Any]

MAX_BATCH_BYTES = 2**27  # maximum bytes of fields that pass the microscope together


class ObjectiveCamera:
    """Camera behind an objective; `Microscope` documents its fields."""

    magnification: float
    na: float
    medium_index: float
    wavelength: float
    device: Device
    cover: CoverGlass | None
    apodisation: float

    @property
    def objective(self) -> Objective:
        """Objective with its tube lens."""
        return Objective(
            self.magnification, self.na, self.medium_index, self.wavelength, self.cover,
            self.apodisation,
        )  # fmt: skip

    @abstractmethod
    def sensor_fields(self, points: PointSources, window: Grid) -> Field:
        """Compute fields of points on the sensor, shape (n, ny, nx) of a periodic window."""

    def to_sensor(self, window: Grid, distance: float) -> Propagator:
        """Plan the propagation from the lenslets to the sensor, by the angular spectrum."""
        return plan(
            window, distance, wavelength=self.wavelength, method="as", pad=1,
            device=self.device,
        )  # fmt: skip

    def batches(self, points: PointSources, window: Grid) -> Iterator[PointSources]:
        """Yield points in batches whose fields on a window fit the memory."""
        nbytes = math.prod(window.shape) * self.device.complex.itemsize
        count = max(1, MAX_BATCH_BYTES // nbytes)
        self.device.require_memory(4 * count * nbytes, "This exposure")
        for start in range(0, len(points), count):
            yield points.chosen(slice(start, start + count))

    def energies(self, points: PointSources, window: Grid, progress: Progress | None) -> Vector:
        """Return the energy of all points on the samples of a window, in the device's precision."""
        total, done = self.device.zeros(window.shape, self.device.real), 0
        for some in self.batches(points, window):
            fields = self.sensor_fields(some, window)
            accumulate(total, fields.data, some.power, self.device)
            done += len(some)
            if progress is not None:
                progress(done, len(points))
        return self.device.download(total)
