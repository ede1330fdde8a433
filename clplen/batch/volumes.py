"""Volumes behind frames of a light-field microscope, one after the other with one projector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike, naming
from clplen.io.raw import read_frame
from clplen.io.volume import write_volume
from clplen.microscopy import psffile
from clplen.microscopy.deconvolution import DeconvolutionResult, deconvolve
from clplen.microscopy.images import PointImages
from clplen.microscopy.prepare import Prepared, preparation
from clplen.microscopy.projector import Projector

Values = np.ndarray[Any, Any]

FLOOR = 1e-3  # of the mean voxel: a warm start leaves none at 0, where it would stay


@dataclass(frozen=True)
class How:
    """How frames are deconvolved; it decides the volumes.

    Attributes
    ----------
    iterations : int
    background : float
        Counts of a pixel of the camera above the dark frame.
    gain : float
        Counts of a photon.
    saturation : float or None
        Level from which on pixels are left out.
    haze : bool
        Whether light from far beyond the volume is told from it; see `Preparation.haze`.
    residual, accelerate, prior, strength
        Of `deconvolve`.
    """

    iterations: int = 20
    background: float = 0.0
    gain: float = 1.0
    saturation: float | None = None
    haze: bool = False
    residual: float | Literal["noise"] | None = None
    accelerate: bool = False
    prior: Literal["tv", "gaussian"] | None = None
    strength: float = 1.0


class Deconvolver:
    """What frames of one camera share: point images, lattice and matrices.

    Parameters
    ----------
    images : PointImages
    how : How
    device : Device
    white, dark : path-like, optional
        Frames; without a white one frames are rectified already.
    memory : int, optional
        As of `Projector`.

    Raises
    ------
    FormatError
        If a file is missing, damaged or of another kind.
    ShapeError, ValueError
        As `preparation`.
    """

    def __init__(
        self,
        images: PointImages,
        how: How,
        *,
        device: Device,
        white: PathLike | None = None,
        dark: PathLike | None = None,
        memory: int | None = None,
    ) -> None:
        self.images, self.how, self.device, self._memory = images, how, device, memory
        beside = {
            name: read_picture(path) for name, path in (("white", white), ("dark", dark)) if path
        }
        with naming(white or "Without a white frame"):
            self._prepare = preparation(
                self.images.pixels, device=device, saturation=how.saturation, **beside
            )
        self._projector: Projector | None = None

    def prepared(self, frame: Values) -> Prepared:
        """A raw frame, rectified."""
        return self._prepare(frame, saturation=self.how.saturation)

    def __call__(
        self,
        frame: Prepared,
        *,
        start: Values | None = None,
        progress: Callable[[int, int], None] | None = None,
        watch: Callable[[Values], None] | None = None,
    ) -> DeconvolutionResult:
        """The volume behind a frame.

        Parameters
        ----------
        frame : Prepared
        start : numpy.ndarray, optional
            Volume of the frame before.
        progress, watch : callable, optional
            As of `deconvolve`.
        """
        how = self.how
        counts = frame.counts / np.float32(how.gain)
        background = np.full_like(counts, how.background * self._prepare.area / how.gain)
        if how.haze:
            background += self._prepare.haze(counts - background, frame.white)
        if start is not None:
            start = np.maximum(start, np.float32(FLOOR * start.mean(dtype=np.float64)))
        return deconvolve(
            counts,
            self._projector_for(frame.counts.shape),
            iterations=how.iterations,
            background=background,
            white=frame.white,
            start=start,
            residual=how.residual,
            variance=self._prepare.variance,
            accelerate=how.accelerate,
            prior=how.prior,
            strength=how.strength,
            progress=progress,
            watch=watch,
        )

    def _projector_for(self, shape: tuple[int, ...]) -> Projector:
        lenslets = (shape[0] // self.images.pixels, shape[1] // self.images.pixels)
        if self._projector is None or self._projector.shape != lenslets:
            self._projector = None  # its matrices go before others come
            self._projector = Projector(
                self.images, lenslets, device=self.device, memory=self._memory
            )
        return self._projector


def read_psf(path: PathLike) -> PointImages:
    """Point images of a file; a parameter file in its place is told from it."""
    if Path(path).suffix.lower() == ".toml":
        raise FormatError(
            f"{path} has the parameters of a microscope, not its point images: make them by "
            f"'clplen microscope psf {path} -o PSF.h5'."
        )
    return psffile.read(path)


def read_picture(path: PathLike, frame: int | None = None) -> Values:
    """A frame of one channel, of a file or of its ``frame``."""
    picture, _ = read_frame(path, frame=frame)
    if picture.ndim != 2:
        raise FormatError(f"{path} has shape {picture.shape}; a raw frame has one channel.")
    return picture


def write_result(
    path: PathLike,
    found: DeconvolutionResult,
    images: PointImages,
    *,
    more: dict[str, Any],
    replace: bool = False,
) -> None:
    """Write a volume with what is known of it.

    Parameters
    ----------
    path : path-like
        As of `write_volume`.
    found : DeconvolutionResult
        Of one frame.
    images : PointImages
    more : dict
        What else its description says.
    replace : bool
        As of `write_volume`.
    """
    write_volume(
        path,
        found.volume,
        planes=images.planes,
        voxel=(images.side, images.side),
        description={
            "values": "energy of a voxel, photons (counts over the gain) of the frame",
            "residuals": [float(one) for one in found.residuals],
            "degenerate_um": [round(z * 1e6, 9) for z in found.degenerate],
            **more,
        },
        durable=True,
        replace=replace,
    )
