"""Images of single points by geometrical rays, as a sparse matrix."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.exposure.ray_exposure import point_rays
from clplen.cameras.optics.ray_optics import RayOptics
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.device import Device
from clplen.wave.field.intensity import add_scaled

Values = np.ndarray[Any, np.dtype[np.float64]]
Counts = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class RayImages:
    """Images of points by rays; see `SourceImages`."""

    which: Counts  # which points of a scene, int64, shape (n,)
    matrix: Any  # float64, shape (n, pixels)
    device: Device

    @property
    def nbytes(self) -> int:
        """Bytes on the host."""
        parts = (self.matrix.data, self.matrix.indices, self.matrix.indptr)
        return sum(int(part.nbytes) for part in parts)

    def add(self, totals: cla.Array, energies: Values) -> None:
        """As of `SourceImages`."""
        images = (self.matrix.T @ energies.T).T  # (batch, pixels)
        _, _, nx = totals.shape
        picture = self.device.upload(np.ascontiguousarray(images, totals.dtype).reshape(-1, nx))
        add_scaled(totals.reshape(-1, nx), picture, 1.0, self.device)

    def inner(self, pictures: cla.Array) -> Values:
        """As of `SourceImages`."""
        flat = self.device.download(pictures).reshape(pictures.shape[0], -1)
        return np.asarray((self.matrix @ flat.T.astype(np.float64)).T)


def ray_images(optics: RayOptics, points: PointSources, count: int) -> Iterator[RayImages]:
    """Images of points by ``count`` rays each, some at a time."""
    from scipy import sparse  # a slow import

    ny, nx = optics.grid.shape
    for rays in point_rays(optics, points, count):
        rows = np.broadcast_to(np.arange(len(rays.which))[:, None], rays.pixels.shape)
        hit = rays.pixels >= 0
        entries = (rays.shares[hit], (rows[hit], rays.pixels[hit]))
        matrix = sparse.coo_matrix(entries, shape=(len(rays.which), ny * nx)).tocsr()
        yield RayImages(rays.which, matrix, optics.device)
