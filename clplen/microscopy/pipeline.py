"""Deconvolution of frames of a light-field microscope; matrices are shared from item to item."""

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
from clplen.microscopy.model.cells import place_of
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
    found_in_batches,
    rolling_minimum,
)
from clplen.microscopy.series.starts import Start
from clplen.microscopy.settings import DeconvolutionSettings


class Deconvolver:
    """What frames of one camera share: point images, lattice and matrices.

    Called with a frame of `prepared`, it returns its volume, a `DeconvolutionResult`.

    Parameters
    ----------
    images : PointImages or FourierPointImages
        Of the microscope, as `clplen.point_images` makes them, or
        `clplen.microscopy.fourier_point_images`, whose frames are not rectified.
    how : DeconvolutionSettings
        Iterations, background, gain and what else decides the volumes.
    device : Device or str, optional
        Default ``Device.open()``.
    white, dark : path-like, optional
        Frames; without a white one frames are rectified already. Point images with
        ``sensor_pixels``, or of another than a square array, need one: frames are then not
        rectified but explained as they are (`clplen.microscopy.FrameProjector`).
    memory : int, optional
        Bytes for matrices, as of `Projector`.
    force : bool
        Whether to go on where the lattice of the white frame is not to be trusted, as of
        `preparation`.
    lattice : Lattice, optional
        Of frames without a white one, with their shape.
    mask : path-like, optional
        Picture that is not 0 where pixels are left out.

    Attributes
    ----------
    pupil : PupilCheck or None
        How the point images' pupil fits the white frame; None without one.

    Raises
    ------
    FormatError
        If a file is missing, damaged or of another kind.
    ShapeError, ValueError
        As `preparation`; if the settings are radiometric without a white frame.

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
        self.begin = Start(how.start, images, motion=how.motion)
        self._files = {"white": white, "dark": dark, "mask": mask}
        self._lattice = lattice
        self.pupil: PupilCheck | None = None
        beside = {name: read_picture(path) for name, path in self._files.items() if path}
        with naming(white or mask or "Without a white frame"):
            self._prepare = self._prepared_for(beside, force)
        self._projector: Projector | FourierProjector | None = None

    def _prepared_for(self, beside: dict[str, Values], force: bool) -> Preparation:
        """What frames share, rectified or as they are."""
        images, how = self.images, self.how
        given: dict[str, Any] = {"device": self.device, "saturation": how.saturation, **beside}
        given["force"] = force
        if isinstance(images, FourierPointImages):
            _refuse_of_others(beside, self._lattice, how.radiometric)
            return preparation(1, sharpest=None if how.keep_hot else sharpness(images), **given)
        if "sensor_pixels" not in images.parameters and images.cell.lenslets == (1, 1):
            return self._rectified(images, given)
        if "white" not in beside:
            raise ValueError(
                "these point images are those of frames that are not rectified, whose lattice the "
                "white frame tells: give it."
            )
        if how.radiometric:
            raise ValueError(
                "The correction of the pupil (radiometric) is for rectified frames: leave it out, "
                "or make point images without --unrectified."
            )
        return raw_preparation(images, find_hot=not how.keep_hot, memory=self._memory, **given)

    def _rectified(self, images: PointImages, given: dict[str, Any]) -> Preparation:
        """What frames share that are rectified; the pupil is compared with the white one."""
        how = self.how
        sharpest = None if how.keep_hot else sharpness(images)
        found = preparation(images.pixels, lattice=self._lattice, sharpest=sharpest, **given)
        self.pupil = check_pupil(images, found)
        if not how.radiometric or self.pupil is None:
            return found
        return corrected(found, self.pupil)

    @cached_property
    def words(self) -> dict[str, Any]:
        """What all volumes depend on; see `provenance`."""
        return provenance(self.images, self.how, **self._files, lattice=self._lattice)

    def checks(self) -> list[str]:
        """Return sentences on the settings, the white frame and the point images."""
        how, said = self.how, []
        if how.gain is None and (how.residual == "noise" or how.prior in ("tv", "time")):
            what = "residual noise" if how.residual == "noise" else f"prior {how.prior}"
            said.append(f"{what} takes each count as a photon: give the gain of the camera.")
        if self._files["white"] and not self._files["dark"]:
            said.append(
                "without a dark frame the offset of the camera counts as light: do not compare "
                "residuals and volumes with those made with a dark frame."
            )
        if isinstance(self.images, FourierPointImages):
            return said
        return said + diagnostics.diagnose_series(
            self.images, self._prepare, self.pupil, how.radiometric
        )

    def prepared(self, frame: Values) -> Prepared:
        """A raw frame, rectified where point images are those of rectified frames."""
        return self._prepare(frame, saturation=self.how.saturation)

    def place(self) -> dict[str, tuple[float, float]]:
        """Of the voxels on the raw frame; see `Preparation.place`.

        Of a Fourier microscope under the sub-image that is nearest to the middle.
        """
        if isinstance(self.images, FourierPointImages):
            return _under_the_middle(self.images)
        return self._prepare.place(self.images.voxels)

    def diagnose(
        self, frame: Prepared, found: DeconvolutionResult | None = None, low: Values | None = None
    ) -> list[str]:
        """Sentences on a frame, or on its volume; see `clplen.microscopy.diagnostics`."""
        prepare = self._prepare
        if isinstance(prepare, RawPreparation):  # sub-images have no pixels to be compared
            prepare = replace(prepare, level=None)
        if found is None:
            return diagnostics.diagnose_frame(prepare, frame, self.how.background)
        if isinstance(prepare, RawPreparation):
            return []
        _, background = self._light(frame, low)
        gain, variance = self.how.gain or 1.0, self._prepare.variance
        level = self._prepare.level
        pupil = 0.0 if self.pupil is None or self.how.radiometric else self.pupil.share
        placed = self._prepare.lattice is not None or isinstance(self.images, FourierPointImages)
        return diagnostics.diagnose_volume(
            found.residuals, frame, background * gain, level, self._prepare.pixels, gain * variance,
            pupil=pupil, placed=placed,
        )  # fmt: skip

    def _light(self, frame: Prepared, low: Values | None = None) -> tuple[Values, Values]:
        """Photons of a frame, and those from nowhere in the volume: at least ``low`` counts."""
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
        """Return the volume behind a prepared frame; ``start`` is the volume of the frame before.

        ``progress`` and ``watch`` are those of `deconvolve`.
        """
        counts, background = self._light(frame)
        begin = self.begin if self.begin.name else Start("previous", self.images)
        begun = None if start is None else begin.volumes(start, 1)
        return deconvolve(
            counts,
            self.projector_for(frame.counts.shape),
            background=background,
            white=frame.white,
            start=None if begun is None else begun[0],
            progress=progress,
            watch=watch,
            **self._options,
        )

    @property
    def _options(self) -> dict[str, Any]:
        """Those of `deconvolve` that all frames share."""
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
        """Frames of a shape that are found together; see `clplen.microscopy.deconvolve_series`."""
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
        """Yield the volumes behind frames, ``batch`` at a time.

        Frames come with counts that are at least background, as of `lowest`, or None; all have
        ``shape``. ``before`` is the volume of the frame before the first one; ``progress`` and
        ``watch`` are those of `deconvolve`, of each batch.
        """
        lit = (SeriesFrame(*self._light(frame, low), frame.white) for frame, low in frames)
        return found_in_batches(
            lit, self.projector_for(shape), batch, self.begin, before=before,
            progress=progress, watch=watch, **self._options,
        )  # fmt: skip

    def projector_for(self, shape: tuple[int, ...]) -> Projector | FourierProjector:
        """The projector of frames of a shape; that of the frame before where it is the same."""
        if isinstance(self._prepare, RawPreparation) and self._prepare.projector is not None:
            return self._prepare.projector
        if isinstance(self.images, FourierPointImages):
            return self._fourier_projector(self.images, shape)
        lenslets = (shape[0] // self.images.pixels, shape[1] // self.images.pixels)
        if self._projector is None or self._projector.shape != lenslets:
            self._projector = None  # its matrices go before others come
            self._projector = Projector(
                self.images, lenslets, device=self.device, memory=self._memory
            )
        return self._projector

    def _fourier_projector(
        self, images: FourierPointImages, shape: tuple[int, ...]
    ) -> FourierProjector:
        if shape != images.shape:
            raise ShapeError(
                f"The frame has {shape[0]} x {shape[1]} pixels, the sensor of the point images "
                f"{images.shape[0]} x {images.shape[1]}: give the whole frame, or sensor = "
                f"[{shape[0]}, {shape[1]}] to the camera."
            )
        if not isinstance(self._projector, FourierProjector):
            self._projector = FourierProjector(images, device=self.device, memory=self._memory)
        return self._projector


def _refuse_of_others(beside: dict[str, Values], lattice: Lattice | None, corrected: bool) -> None:
    """Refuse what frames of a Fourier microscope do not have."""
    if "white" in beside or lattice is not None or corrected:
        raise ValueError(
            "Point images of a Fourier microscope know its sub-images, and how bright they "
            "are: leave the white frame, the lattice and the radiometric correction out."
        )


def _under_the_middle(images: FourierPointImages) -> dict[str, tuple[float, float]]:
    """As `Preparation.place`, of the sub-image nearest to the middle of the sensor."""
    middle = (np.array(images.shape) - 1) / 2
    nearest = images.centres[np.square(images.centres - middle).sum(axis=1).argmin()]
    b = images.voxels
    first = nearest - np.array(images.field) // 2 - (b - 1) / (2 * b)
    return place_of(first, (1 / b, 0.0), (0.0, 1 / b))


def lowest(frames: Iterable[Prepared], window: int) -> Iterator[tuple[Prepared, Values]]:
    """Frames with the minimum of each pixel over the frames about them."""
    held: deque[Prepared] = deque()

    def counts() -> Iterator[Values]:
        for frame in frames:
            held.append(frame)
            yield frame.counts

    for _, low in rolling_minimum(counts(), window):
        yield held.popleft(), low


def provenance(
    images: AnyImages,
    how: DeconvolutionSettings,
    *,
    white: PathLike | None = None,
    dark: PathLike | None = None,
    mask: PathLike | None = None,
    lattice: Lattice | None = None,
) -> dict[str, Any]:
    """What volumes of one camera depend on besides their frames, kept with them."""
    from clplen import __version__

    return {
        **how.of_frames,
        "clplen": __version__,
        "psf": point_image_files.digest(images),
        "white": digest(Path(white)) if white else None,
        "dark": digest(Path(dark)) if dark else None,
        "mask": digest(Path(mask)) if mask else None,
        "lattice": None if lattice is None else [*lattice.origin, *lattice.row, *lattice.column],
    }
