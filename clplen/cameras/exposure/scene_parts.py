"""Scenes as input of linear maps: points and the wavelengths that expose them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.exposure.ray_exposure import check_rays, point_rays, ray_count
from clplen.cameras.exposure.source_images import SourceImages, local_images, point_images
from clplen.cameras.exposure.spectral_exposure import spectral_lines
from clplen.cameras.exposure.wave_exposure import (
    Light,
    Method,
    check_occluders,
    check_positions,
    is_local,
)
from clplen.cameras.optics.ray_optics import RayOptics, check_in_view
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources, Source
from clplen.compute.device import Device
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.field.intensity import add_scaled

Values = np.ndarray[Any, np.dtype[np.float64]]
Counts = np.ndarray[Any, np.dtype[np.int64]]
Maker = Callable[[Any, PointSources], Iterator[SourceImages]]


@dataclass(frozen=True, eq=False)
class RayImages:
    """Images of points by rays; see `SourceImages`."""

    indices: Counts  # indices of the points in a scene, int64, shape (n,)
    matrix: Any  # float64, shape (n, pixels)
    device: Device

    @property
    def nbytes(self) -> int:
        """Number of bytes on the host."""
        parts = (self.matrix.data, self.matrix.indices, self.matrix.indptr)
        return sum(int(part.nbytes) for part in parts)

    def add(self, totals: cla.Array, energies: Values) -> None:
        """Implement `SourceImages.add`."""
        images = (self.matrix.T @ energies.T).T  # (batch, pixels)
        _, _, nx = totals.shape
        picture = self.device.upload(np.ascontiguousarray(images, totals.dtype).reshape(-1, nx))
        add_scaled(totals.reshape(-1, nx), picture, 1.0, self.device)

    def inner(self, pictures: cla.Array) -> Values:
        """Implement `SourceImages.inner`."""
        flat = self.device.download(pictures).reshape(pictures.shape[0], -1)
        return np.asarray((self.matrix @ flat.T.astype(np.float64)).T)


def ray_images(optics: RayOptics, points: PointSources, count: int) -> Iterator[RayImages]:
    """Yield images of points by ``count`` rays each, in batches."""
    from scipy import sparse  # a slow import

    ny, nx = optics.grid.shape
    for rays in point_rays(optics, points, count):
        rows = np.broadcast_to(np.arange(len(rays.indices))[:, None], rays.pixels.shape)
        hit = rays.pixels >= 0
        entries = (rays.shares[hit], (rows[hit], rays.pixels[hit]))
        matrix = sparse.coo_matrix(entries, shape=(len(rays.indices), ny * nx)).tocsr()
        yield RayImages(rays.indices, matrix, optics.device)


@dataclass(frozen=True, eq=False)
class SceneLine:
    """Wavelength and weights of an exposure of points."""

    optics: Any  # camera at that wavelength
    # signal of a unit of energy of each channel behind each filter, shape (channels, filters)
    weights: Values


@dataclass(frozen=True, eq=False)
class ScenePart:
    """Points of a member of a scene, with their wavelengths."""

    points: PointSources  # points of the member; for pictures the samples that send light
    # index of each point among the member's values, before its channels, int64, shape (n,)
    indices: Counts
    shape: tuple[int, ...]  # shape of the member's values; several channels are the last axis
    channels: int
    lines: tuple[SceneLine, ...]
    route: str
    # function that computes images from the optics of a line and points; for a microscope
    maker: Maker | None = None

    @classmethod
    def of(
        cls,
        source: Source,
        lines: Sequence[SceneLine],
        route: str,
        maker: Maker | None = None,
    ) -> ScenePart:
        """Return the part of a source."""
        if isinstance(source, PointSources):
            count = len(source)
            return cls(source, np.arange(count), (count,), 1, tuple(lines), route, maker)
        lit = np.flatnonzero(source.energy)
        channels = source.image.shape[2] if source.image.ndim == 3 else 1
        return cls(source.points(), lit, source.image.shape, channels, tuple(lines), route)

    @property
    def size(self) -> int:
        """Number of values."""
        return int(np.prod(self.shape))

    def energies(self, values: Values) -> Values:
        """Return energies (batch, n, channels) of points and channels from values (batch, size)."""
        return values.reshape(len(values), -1, self.channels)[:, self.indices]

    def spread(self, values: Values) -> Values:
        """Return all values of the member, raveled, from (n, channels) of its points, else 0."""
        member_values = np.zeros((self.size // self.channels, self.channels))
        member_values[self.indices] = values
        return member_values.ravel()

    def images(self, line: SceneLine, all_points: int) -> Iterator[SourceImages]:
        """Yield images of the points at a wavelength, in batches."""
        if self.maker is not None:
            return self.maker(line.optics, self.points)
        if self.route == "rays":
            return ray_images(line.optics, self.points, ray_count(all_points))
        makers = {"points": point_images, "local": local_images}
        return makers[self.route](line.optics, self.points)


class SceneImages:
    """Images of all points of a scene at all wavelengths, stored if they fit the memory."""

    def __init__(self, parts: tuple[ScenePart, ...], memory: int) -> None:
        self.parts, self.memory = parts, memory
        self._kept: list[tuple[int, SceneLine, SourceImages]] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without images on a device, which are computed again on demand."""
        return self.__dict__ | {"_kept": None}

    def __iter__(self) -> Iterator[tuple[int, SceneLine, SourceImages]]:
        """Yield the index of a part, a wavelength, and images of a batch of points."""
        if self._kept is not None:
            yield from self._kept
            return
        stored: list[tuple[int, SceneLine, SourceImages]] | None = []
        count, nbytes = sum(len(part.points) for part in self.parts), 0
        for index, line in self.lines():
            for images in self.parts[index].images(line, count):
                nbytes += images.nbytes
                if stored is not None:
                    stored = None if nbytes > self.memory else [*stored, (index, line, images)]
                yield index, line, images
        self._kept = stored

    def lines(self) -> Iterator[tuple[int, SceneLine]]:
        """Yield the index of a part and a wavelength."""
        for index, part in enumerate(self.parts):
            for line in part.lines:
                yield index, line

    def energies(self, values: Values, index: int) -> Values:
        """Return energies (batch, n, channels) of a part's points, of all values (batch, size)."""
        first = sum(part.size for part in self.parts[:index])
        part = self.parts[index]
        return part.energies(values[:, first : first + part.size])

    @property
    def nbytes(self) -> int:
        """Bytes of the images that are stored at present."""
        return sum(images.nbytes for _, _, images in self._kept or [])


def wave_parts(
    optics: WaveOptics, sources: Sequence[Source], coherence: Coherence | None, method: Method
) -> list[ScenePart]:
    """Return points and self-luminous pictures exposed by waves."""
    if method not in ("auto", "points", "local"):
        raise ValueError(
            f"method must be 'auto', 'points' or 'local' for a linear map, got {method!r}: the "
            "patterns of 'isoplanatic' apply to a single exposure."
        )
    _reject_slides(sources)
    light = Light(coherence, True, {})
    light.check(0)
    check_occluders(optics, method, has_slides=False)
    local = is_local(optics, method)
    parts = []
    for source in sources:
        lines = _lines(optics, source, light)
        for line in (lines[0], lines[-1]):
            check_positions(line.optics, source, local=local, slide=False)
        parts.append(ScenePart.of(source, lines, "local" if local else "points"))
    return parts


def ray_parts(
    optics: WaveOptics, sources: Sequence[Source], coherence: Coherence | None, method: Method
) -> list[ScenePart]:
    """Return points and self-luminous pictures exposed by rays."""
    _reject_slides(sources)
    check_rays(optics, optics.occluders)
    if coherence is not None or method != "auto":
        raise ValueError(
            "coherence and method require model='waves': leave them out, because rays are "
            "incoherent and have one method."
        )
    parts = []
    for source in sources:
        points = source if isinstance(source, PointSources) else source.points()
        check_in_view(optics, points.positions)
        channels = 1 if isinstance(source, PointSources) or source.spectra is None else None
        count = channels or source.image.shape[-1]  # type: ignore[union-attr]
        parts.append(ScenePart.of(source, [SceneLine(optics, np.ones((count, 1)))], "rays"))
    return parts


def microscope_parts(
    sources: Sequence[Any], lines: Sequence[tuple[float, float]], camera: Any, maker: Maker
) -> list[ScenePart]:
    """Return points exposed by a `Microscope` at wavelengths with fractions of the energy."""
    if not all(isinstance(source, PointSources) for source in sources):
        raise ValueError(
            "A microscope exposes PointSources only: replace pictures by points, or project a "
            "volume (clplen.microscopy.Projector)."
        )
    scene_lines = [
        SceneLine(replace(camera, wavelength=wavelength), np.array([[share]]))
        for wavelength, share in lines
    ]
    for source in sources:
        camera.window(source)
    return [ScenePart.of(source, scene_lines, "microscope", maker) for source in sources]


def _reject_slides(sources: Sequence[Source]) -> None:
    if any(isinstance(source, PicturePlane) and source.is_slide for source in sources):
        raise ValueError(
            "The raw image of a slide is not linear in its transmittance: use PointSources, or "
            "pictures with mode='emission'."
        )


def _lines(optics: WaveOptics, source: Source, light: Light) -> list[SceneLine]:
    """Return the wavelengths of a source in ascending or descending order."""
    if optics.filters is None and source.spectra is None:
        return [
            SceneLine(replace(optics, wavelength=wavelength), np.array([[share]]))
            for wavelength, share in light.lines(optics.wavelength)
        ]
    return [
        SceneLine(replace(optics, wavelength=line.wavelength), line.weights)
        for line in spectral_lines(optics, source, light.coherence)
    ]
