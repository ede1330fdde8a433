"""Deconvolution of the frames of a light-field microscope, with matrices shared between frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from clplen.compute.device import DeviceLike, as_device
from clplen.errors import ShapeError
from clplen.files import PathLike, naming
from clplen.io.store.digest import digest
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy import diagnostics
from clplen.microscopy.deconvolution_files import Values, read_picture
from clplen.microscopy.frames.prepare import Preparation, Prepared, preparation
from clplen.microscopy.frames.raw_frames import RawPreparation, raw_preparation
from clplen.microscopy.frames.sharpness import sharpness
from clplen.microscopy.model import point_image_files
from clplen.microscopy.model.cells import voxel_grid
from clplen.microscopy.model.fourier_images import FourierPointImages
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.model.point_image_files import AnyImages
from clplen.microscopy.pupil.pupil_check import PupilCheck, check_pupil, corrected
from clplen.microscopy.reconstruction.deconvolution import DeconvolutionResult, deconvolve
from clplen.microscopy.reconstruction.fourier_projector import FourierProjector
from clplen.microscopy.reconstruction.projector import Projector
from clplen.microscopy.series.series import (
    SeriesFrame,
    batch_for,
    deconvolve_batches,
    rolling_minimum,
)
from clplen.microscopy.series.starts import Start
from clplen.microscopy.settings import DeconvolutionSettings


class Deconvolver:
    """Deconvolution of all frames of a camera, with shared point images, lattice and matrices.

    Calling it with a frame from `prepared` returns its volume, a `DeconvolutionResult`.

    Parameters
    ----------
    images : PointImages or FourierPointImages
        Point images of the microscope, from `clplen.point_images` or
        `clplen.microscopy.fourier_point_images`. Frames of a Fourier microscope are not rectified.
    how : DeconvolutionSettings
        Iterations, background, gain and the other settings that determine the volumes.
    device : Device or str, optional
        Default ``Device.open()``.
    white, dark : path-like, optional
        White and dark frame; without a white frame, frames must be rectified already. Point images
        with ``sensor_pixels``, or of an array that is not square, require a white frame: raw
        frames are then modelled without rectification (`clplen.microscopy.FrameProjector`).
    memory : int, optional
        Memory for matrices in bytes; see `Projector`.
    force : bool
        True to continue with an unreliable lattice of the white frame; see `preparation`.
    lattice : Lattice, optional
        Lattice of frames without a white frame, with the shape of the frames.
    mask : path-like, optional
        Picture with nonzero values at excluded pixels.

    Attributes
    ----------
    pupil : PupilCheck or None
        Comparison of the modelled pupil with the white frame; None without a white frame.

    Raises
    ------
    FormatError
        If a file is missing, damaged or of another kind.
    ShapeError, ValueError
        See `preparation`; also if the settings are radiometric without a white frame.

    Examples
    --------
    >>> about = {"magnification": 20.0, "na": 0.5, "medium_index": 1.0, "lenslet_pitch": 125e-6}
    >>> spots = (np.full((1, 15, 15), 1 / 225, np.float32),)  # 3 x 3 lenslets, evenly lit
    >>> images = clplen.microscopy.PointImages(about, np.array([20e-6]), 1, 5, spots, np.ones(1))
    >>> how = clplen.microscopy.DeconvolutionSettings()
    >>> deconvolver = clplen.microscopy.Deconvolver(images, how)
    >>> frame = deconvolver.prepared(np.full((25, 25), 100.0, np.float32))
    >>> deconvolver(frame).volume.shape
    (1, 5, 5)
    """

    def __init__(
        self,
        images: AnyImages,
        how: DeconvolutionSettings,
        *,
        device: DeviceLike | None = None,
        white: PathLike | None = None,
        dark: PathLike | None = None,
        memory: int | None = None,
        force: bool = False,
        lattice: Lattice | None = None,
        mask: PathLike | None = None,
    ) -> None:
        device = as_device(device)
        self.images, self.how, self.device, self._memory = images, how, device, memory
        how.require_white(white is not None)
        self.start = Start(how.start, images, motion=how.motion)
        self._files = {"white": white, "dark": dark, "mask": mask}
        self._lattice = lattice
        self.pupil: PupilCheck | None = None
        references = {name: read_picture(path) for name, path in self._files.items() if path}
        with naming(white or mask or "Without a white frame"):
            self._prepare = self._preparation(references, force)
        self._projector: Projector | FourierProjector | None = None

    def _preparation(self, references: dict[str, Values], force: bool) -> Preparation:
        """Return the preparation of rectified or of raw frames, as the point images need it."""
        images, how = self.images, self.how
        options: dict[str, Any] = {
            "device": self.device, "saturation": how.saturation, "force": force, **references
        }  # fmt: skip
        if isinstance(images, FourierPointImages):
            _check_fourier(references, self._lattice, how.radiometric)
            return preparation(1, sharpest=None if how.keep_hot else sharpness(images), **options)
        if "sensor_pixels" not in images.parameters and images.cell.lenslets == (1, 1):
            return self._rectified(images, options)
        if "white" not in references:
            raise ValueError(
                "these point images model raw frames without rectification, which requires the "
                "lattice of a white frame: give the white frame."
            )
        if how.radiometric:
            raise ValueError(
                "The correction of the pupil (radiometric) requires rectified frames: leave it "
                "out, or make point images without --unrectified."
            )
        return raw_preparation(images, find_hot=not how.keep_hot, memory=self._memory, **options)

    def _rectified(self, images: PointImages, options: dict[str, Any]) -> Preparation:
        """Return the preparation of rectified frames; compare the pupil with the white frame."""
        how = self.how
        sharpest = None if how.keep_hot else sharpness(images)
        prepare = preparation(images.pixels, lattice=self._lattice, sharpest=sharpest, **options)
        self.pupil = check_pupil(images, prepare)
        if not how.radiometric or self.pupil is None:
            return prepare
        return corrected(prepare, self.pupil)

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """Settings, files and point images that all volumes depend on; see `provenance`."""
        return provenance(self.images, self.how, **self._files, lattice=self._lattice)

    def checks(self) -> list[str]:
        """Return messages about the settings, the white frame and the point images."""
        how, messages = self.how, []
        if how.gain is None and (how.residual == "noise" or how.prior in ("tv", "time")):
            setting = "residual noise" if how.residual == "noise" else f"prior {how.prior}"
            messages.append(f"{setting} treats counts as photons: give the gain of the camera.")
        if self._files["white"] and not self._files["dark"]:
            messages.append(
                "without a dark frame the offset of the camera counts as light: do not compare "
                "residuals and volumes with those made with a dark frame."
            )
        if isinstance(self.images, FourierPointImages):
            return messages
        return messages + diagnostics.diagnose_series(
            self.images, self._prepare, self.pupil, how.radiometric
        )

    def prepared(self, frame: Values) -> Prepared:
        """Prepare a raw frame; rectify it if the point images require it."""
        return self._prepare(frame, saturation=self.how.saturation)

    def voxel_grid(self) -> dict[str, tuple[float, float]]:
        """Return the voxel grid on the raw frame; see `Preparation.voxel_grid`.

        For a Fourier microscope it is the grid under the sub-image nearest to the centre.
        """
        if isinstance(self.images, FourierPointImages):
            return _central_voxel_grid(self.images)
        return self._prepare.voxel_grid(self.images.voxels)

    def diagnose(
        self, frame: Prepared, result: DeconvolutionResult | None = None, low: Values | None = None
    ) -> list[str]:
        """Return messages about a frame, or about its volume; see `diagnostics`."""
        prepare = self._prepare
        if isinstance(prepare, RawPreparation):  # raw sub-images have no common pixel grid
            prepare = replace(prepare, level=None)
        if result is None:
            return diagnostics.diagnose_frame(prepare, frame, self.how.background)
        if isinstance(prepare, RawPreparation):
            return []
        _, background = self._light(frame, low)
        gain, variance = self.how.gain or 1.0, self._prepare.variance
        level = self._prepare.level
        pupil = 0.0 if self.pupil is None or self.how.radiometric else self.pupil.share
        is_fourier = isinstance(self.images, FourierPointImages)
        return diagnostics.diagnose_volume(
            result.residuals, frame, background * gain, level, self._prepare.pixels,
            gain * variance, pupil=pupil,
            is_located=self._prepare.lattice is not None or is_fourier,
        )  # fmt: skip

    def _light(self, frame: Prepared, low: Values | None = None) -> tuple[Values, Values]:
        """Return the photons of a frame and its background, at least ``low`` counts."""
        how, gain = self.how, self.how.gain or 1.0
        counts = frame.counts / np.float32(gain)
        background = np.full_like(counts, how.background * self._prepare.area / gain)
        if low is not None:
            background = np.maximum(background, low / np.float32(gain))
        if how.haze:
            background += self._prepare.haze(counts - background, frame.white)
        return counts, background

    def __call__(
        self,
        frame: Prepared,
        *,
        start: Values | None = None,
        progress: Callable[[int, int], None] | None = None,
        watch: Callable[[Values], None] | None = None,
    ) -> DeconvolutionResult:
        """Return the volume of a prepared frame; ``start`` is the volume of the previous frame.

        For ``progress`` and ``watch`` see `deconvolve`.
        """
        counts, background = self._light(frame)
        rule = self.start if self.start.name else Start("previous", self.images)
        initial = None if start is None else rule.volumes(start, 1)
        return deconvolve(
            counts,
            self.projector_for(frame.counts.shape),
            background=background,
            white=frame.white,
            start=None if initial is None else initial[0],
            progress=progress,
            watch=watch,
            **self._options,
        )

    @property
    def _options(self) -> dict[str, Any]:
        """Options of `deconvolve` that all frames share."""
        how = self.how
        return {
            "iterations": how.iterations,
            "residual": how.residual,
            "variance": self._prepare.variance,
            "accelerate": how.accelerate,
            "prior": how.prior,
            "strength": how.strength or 1.0,
        }

    def batch(self, shape: tuple[int, ...]) -> int:
        """Return the number of frames per batch; see `clplen.microscopy.deconvolve_series`."""
        how = self.how
        projector = self.projector_for(shape)
        return batch_for(projector, how.batch, accelerate=how.accelerate, prior=how.prior)

    def series(
        self,
        frames: Iterable[tuple[Prepared, Values | None]],
        shape: tuple[int, ...],
        batch: int,
        *,
        before: Values | None = None,
        progress: Callable[[int, int], None] | None = None,
        watch: Callable[[Values], None] | None = None,
    ) -> Iterator[DeconvolutionResult]:
        """Yield the volumes of frames of one ``shape``, ``batch`` frames at a time.

        Each frame is paired with its minimum background counts from `rolling_background`, or None.
        ``before`` is the volume of the frame before the first one. ``progress`` and ``watch`` are
        passed to `deconvolve` with each batch.
        """
        series = (SeriesFrame(*self._light(frame, low), frame.white) for frame, low in frames)
        return deconvolve_batches(
            series, self.projector_for(shape), batch, self.start, before=before,
            progress=progress, watch=watch, **self._options,
        )  # fmt: skip

    def projector_for(self, shape: tuple[int, ...]) -> Projector | FourierProjector:
        """Return the projector of frames of a shape, reused while the shape stays the same."""
        if isinstance(self._prepare, RawPreparation) and self._prepare.projector is not None:
            return self._prepare.projector
        if isinstance(self.images, FourierPointImages):
            return self._fourier_projector(self.images, shape)
        lenslets = (shape[0] // self.images.pixels, shape[1] // self.images.pixels)
        if self._projector is None or self._projector.shape != lenslets:
            self._projector = None  # free its matrices before allocating others
            self._projector = Projector(
                self.images, lenslets, device=self.device, memory=self._memory
            )
        return self._projector

    def _fourier_projector(
        self, images: FourierPointImages, shape: tuple[int, ...]
    ) -> FourierProjector:
        if shape != images.shape:
            raise ShapeError(
                f"The frame must have {images.shape[0]} x {images.shape[1]} pixels, as the sensor "
                f"of the point images, got {shape[0]} x {shape[1]}: give the whole frame, or set "
                f"sensor = [{shape[0]}, {shape[1]}] in the camera."
            )
        if not isinstance(self._projector, FourierProjector):
            self._projector = FourierProjector(images, device=self.device, memory=self._memory)
        return self._projector


def _check_fourier(
    references: dict[str, Values], lattice: Lattice | None, is_corrected: bool
) -> None:
    """Reject a white frame, a lattice or a correction with a Fourier microscope."""
    if "white" in references or lattice is not None or is_corrected:
        raise ValueError(
            "Point images of a Fourier microscope include the positions and the brightness of its "
            "sub-images: leave out the white frame, the lattice and the radiometric correction."
        )


def _central_voxel_grid(images: FourierPointImages) -> dict[str, tuple[float, float]]:
    """Return the voxel grid under the sub-image nearest to the centre of the sensor."""
    middle = (np.array(images.shape) - 1) / 2
    nearest = images.centres[np.square(images.centres - middle).sum(axis=1).argmin()]
    b = images.voxels
    first = nearest - np.array(images.field) // 2 - (b - 1) / (2 * b)
    return voxel_grid(first, (1 / b, 0.0), (0.0, 1 / b))


def rolling_background(
    frames: Iterable[Prepared], window: int
) -> Iterator[tuple[Prepared, Values]]:
    """Yield each frame with the minimum of each pixel over a window of frames about it."""
    queue: deque[Prepared] = deque()

    def counts() -> Iterator[Values]:
        for frame in frames:
            queue.append(frame)
            yield frame.counts

    for _, low in rolling_minimum(counts(), window):
        yield queue.popleft(), low


def provenance(
    images: AnyImages,
    how: DeconvolutionSettings,
    *,
    white: PathLike | None = None,
    dark: PathLike | None = None,
    mask: PathLike | None = None,
    lattice: Lattice | None = None,
) -> dict[str, Any]:
    """Return the settings and digests of files that all volumes of a camera depend on."""
    from clplen import __version__

    return {
        **how.frame_settings,
        "clplen": __version__,
        "psf": point_image_files.digest(images),
        "white": digest(Path(white)) if white else None,
        "dark": digest(Path(dark)) if dark else None,
        "mask": digest(Path(mask)) if mask else None,
        "lattice": None if lattice is None else [*lattice.origin, *lattice.row, *lattice.column],
    }
