"""Partially coherent light: a spatial model, a spectrum, and averages of intensities."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import KW_ONLY, dataclass, replace
from itertools import count as whole_numbers
from itertools import islice
from typing import Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen.checks import check_keywords, check_positive, keywords_of
from clplen.compute.device import DeviceLike, as_device
from clplen.errors import ShapeError
from clplen.progress import notebook_bar
from clplen.reprs import OneLine
from clplen.wave.coherence.averaging import (
    DEFAULT_SNAPSHOTS,
    Averaging,
    Checkpoint,
    Progress,
    average,
    file_and_label,
    verify,
)
from clplen.wave.coherence.coherence_plan import CoherencePlan, check_reach, plan_coherence
from clplen.wave.coherence.exact_mean import require_image, sum_over_source, weighted, without_noise
from clplen.wave.coherence.mean_gradient import MeanPullback, mean_vjp
from clplen.wave.coherence.spatial_models import LARGEST_INDEX, SpatialModel, check_seed
from clplen.wave.elements.beams import plane_wave
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import MeanIntensity, Object, Region, Window
from clplen.wave.field.transmission import multiply
from clplen.wave.spectrum.lineshapes import Table
from clplen.wave.spectrum.spectrum import Spectrum
from clplen.wave.systems.components import Part
from clplen.wave.systems.optical_system import OpticalSystem

System = Callable[[Field], Field]
Method = Literal["auto", "monte-carlo", "abbe"]
METHODS = ("auto", "monte-carlo", "abbe")
DEFAULT_WAVELENGTHS, DEFAULT_TABLE_WAVELENGTHS = 9, 41  # enough for images
MIN_WIDE_WAVELENGTHS = 15  # samples of a Gaussian that extend over +-2 full widths, not +-1.5


@dataclass(frozen=True, repr=False)
class Coherence(OneLine):
    """Light of partial spatial and temporal coherence, between a laser and an ideal lamp.

    Parameters
    ----------
    spatial : RandomPhaseMask, ExtendedSource or IncoherentLight, optional
        Model of spatial coherence, any `SpatialModel`; None: a plane wave, coherent across the
        field.
    spectrum : Spectrum, optional
        Spectrum of the light; None: the wavelength of the illuminated field.
    wavelengths : int, optional
        Number of wavelengths that sample the spectrum. The default is 9, enough for images, or 41
        for a tabulated spectrum. Interferometers need 21 or more; see `Spectrum.needed`. Each
        spectral line has at least one.
    seed : int
        Seed of the snapshots, 0 to 2^64 - 1.

    Raises
    ------
    TypeError
        If ``spatial`` is not a model or ``spectrum`` not a `Spectrum`.
    ValueError
        If the number of wavelengths is below 1 or the seed out of range.

    Notes
    -----
    Wavelengths are mutually incoherent: a snapshot is the weighted sum of the intensities at all
    wavelengths, each with an independent snapshot of the spatial model. Elements receive the field
    at its wavelength and act as path lengths.

    Examples
    --------
    >>> led = clplen.Spectrum.gaussian(550e-9, 30e-9)
    >>> light = clplen.Coherence(clplen.wave.RandomPhaseMask(40e-6), led, wavelengths=3)
    >>> wave = clplen.wave.plane_wave(clplen.Grid((32, 32), 10e-6), wavelength=550e-9)
    >>> hole = clplen.aperture(wave, 150e-6)
    >>> image = clplen.propagate(hole, 5e-3, coherence=light, snapshots=20)
    >>> image.intensity.shape, image.snapshots
    ((32, 32), 20)
    """

    spatial: SpatialModel | None = None
    spectrum: Spectrum | None = None
    _: KW_ONLY
    wavelengths: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.spatial is not None and (
            isinstance(self.spatial, type) or not isinstance(self.spatial, SpatialModel)
        ):
            raise TypeError(
                "spatial must be a RandomPhaseMask, an ExtendedSource or IncoherentLight(), got "
                f"{self.spatial!r}."
            )
        if self.spectrum is not None and not isinstance(self.spectrum, Spectrum):
            raise TypeError(f"spectrum must be a Spectrum, got {self.spectrum!r}.")
        number = 1 if self.wavelengths is None else self.wavelengths
        if not isinstance(number, (int, np.integer)) or isinstance(number, bool) or number < 1:
            raise ValueError(f"wavelengths must be an integer of at least 1, got {number!r}.")
        check_seed(self.seed)

    @property
    def is_random(self) -> bool:
        """True if snapshots differ from each other."""
        return self.spatial is not None and self.spatial.random

    def lines(self, wavelength: float) -> list[tuple[float, float]]:
        """Return wavelengths in metres and their shares of the power, which add up to 1.

        Parameters
        ----------
        wavelength : float
            Wavelength in metres for light without a spectrum.

        Returns
        -------
        list of tuple of float
        """
        if self.spectrum is None:
            return [(float(wavelength), 1.0)]
        is_table = isinstance(self.spectrum.shape, Table)
        default = DEFAULT_TABLE_WAVELENGTHS if is_table else DEFAULT_WAVELENGTHS
        number = self.wavelengths or default
        samples = self.spectrum.sample(number, span=1.5 if number < MIN_WIDE_WAVELENGTHS else 2.0)
        pairs = zip(samples.wavelengths, samples.weights, strict=True)
        return [(float(lam), float(w)) for lam, w in pairs if w > 0]

    def snapshots(
        self,
        grid: Grid,
        *,
        device: DeviceLike | None = None,
        wavelength: float | None = None,
        start: int = 0,
        count: int | None = None,
    ) -> Iterator[Field]:
        """Return an iterator over snapshots of the light in a plane, on the device.

        Parameters
        ----------
        grid : Grid
            Samples of the plane.
        device : Device or str, optional
            Default ``Device.open()``.
        wavelength : float, optional
            Wavelength in metres; by default the centre of the spectrum.
        start : int
            Number of the first snapshot.
        count : int, optional
            Number of snapshots; by default unlimited.

        Yields
        ------
        Field
            Snapshot of shape (ny, nx) with mean intensity 1. Equal numbers give equal snapshots on
            every device.

        Raises
        ------
        SamplingError
            If the grid cannot sample the light.
        """
        device = as_device(device)
        if wavelength is None:
            if self.spectrum is None:
                raise ValueError("Snapshots of light without a spectrum require wavelength=.")
            wavelength = self.spectrum.centre
        check_positive(wavelength=wavelength)
        lam = wavelength
        if self.spatial is not None:
            self.spatial.check(grid, wavelength=lam)
        return (
            self.light(grid, wavelength=lam, device=device, index=index)
            for index in islice(whole_numbers(start), count)
        )

    def light(
        self, grid: Grid, *, wavelength: float, device: DeviceLike | None = None, index: int
    ) -> Field:
        """Return the snapshot with number ``index``; see `snapshots`."""
        if self.spatial is None:
            return plane_wave(grid, wavelength=wavelength, device=device)
        if not 0 <= index <= LARGEST_INDEX:
            raise ValueError(f"index must be from 0 to 2^32 - 1, got {index!r}.")
        return self.spatial.field(
            grid, wavelength=wavelength, device=device, seed=self.seed, index=index
        )

    @notebook_bar("averaging")
    def average(
        self,
        system: System,
        field: Object,
        *,
        snapshots: int | None = None,
        rtol: float | None = None,
        region: Region | None = None,
        checkpoint: Checkpoint | None = None,
        progress: Progress | None = None,
        method: Method = "auto",
    ) -> MeanIntensity:
        """Return the mean intensity behind a system whose object this light illuminates.

        Parameters
        ----------
        system : callable
            Map from Field to Field: an `OpticalSystem` or one of its parts, a `Propagator`, or a
            function.
        field : Field or callable
            Complex transmission of the object, shape (ny, nx), equal at every wavelength; or a
            function that returns it for a wavelength in metres.
        snapshots : int, optional
            Number of snapshots; by default 100, or as many as ``rtol`` needs, at most 100 000.
        rtol : float, optional
            Standard error over mean in the region at which the average stops.
        region : tuple of slice, optional
            Slices (rows, columns) of the image for ``rtol``; by default the whole image.
        checkpoint : path or (path, str), optional
            File from which an interrupted average continues, and a label of the system. The light,
            object, grids, device and label are compared with those of the file. The system itself
            is not compared, so each system needs its own label.
        progress : callable, optional
            Callback with the current and the maximum number of snapshots.
        method : {"auto", "monte-carlo", "abbe"}
            Method: "monte-carlo" averages snapshots; "abbe" sums over the source, exact for systems
            that are shift-invariant in a periodic window; "auto" uses the sum if it is exact and
            affordable, else snapshots.

        Returns
        -------
        MeanIntensity
            Mean intensity with its standard error.

        Raises
        ------
        SamplingError
            If the grid cannot sample the light, no light from the edge of the object reaches the
            first lens, or "abbe" is requested for a system that is not shift-invariant.
        FormatError
            If the checkpoint is damaged or belongs to another configuration.
        """
        if not callable(system):
            system = OpticalSystem([system])
        settings = Averaging(snapshots, rtol, region, checkpoint, progress)
        if method not in METHODS:
            raise ValueError(f"method must be one of {', '.join(METHODS)}, got {method!r}.")
        if checkpoint is not None:
            verify(file_and_label(checkpoint)[0])
        lines = self.lines(_wavelength_of(field, self.spectrum))
        objects = [_object_at(field, lam) for lam, _ in lines]
        shares = [share for _, share in lines]
        self._check(system, objects)
        if self.spatial is None or not self.is_random:
            images = (system(self._lit(transmission, 0)) for transmission in objects)
            image, grid = weighted(images, shares)
            Window.of(region, grid.shape)
            return without_noise(image, grid, "coherent", len(lines))
        if method != "monte-carlo":
            forced = method == "abbe"
            exact = sum_over_source(self.spatial, system, objects, shares, settings, forced=forced)
            if exact is not None:
                return exact
        return self._monte_carlo(system, objects, shares, settings)

    def vjp(
        self,
        system: OpticalSystem | Part,
        field: Field,
        *,
        snapshots: int = DEFAULT_SNAPSHOTS,
        parameters: Iterable[int] = (),
        method: Method = "auto",
    ) -> tuple[MeanIntensity, MeanPullback]:
        """Return the mean intensity behind a system, and the pullback of gradients.

        Parameters
        ----------
        system : OpticalSystem or Part
            System whose parts have adjoints.
        field : Field
            Transmission of the object, shape (ny, nx), equal at every wavelength.
        snapshots : int
            Number of snapshots; gradients are those of their mean.
        parameters : iterable of int
            Indices of the parts whose parameters have gradients, from 0.
        method : {"auto", "monte-carlo", "abbe"}
            Method of `average`.

        Returns
        -------
        MeanIntensity
            Result of `average`.
        MeanPullback
            Map from the gradient by that intensity. It holds the field behind the system for each
            snapshot, up to a quarter of the device's memory. With ``parameters``, or if the sum is
            exact, it computes all fields again.

        Raises
        ------
        ShapeError
            If ``field`` is a batch.
        """
        return mean_vjp(
            self, system, field, snapshots=snapshots, parameters=parameters, method=method
        )

    @classmethod
    def plan(cls, system: Any, *, snr: float, **options: Any) -> CoherencePlan[Coherence]:
        """Return the mask, snapshots and wavelengths for a required signal-to-noise ratio.

        Parameters
        ----------
        system, snr, **options
            Arguments of `plan_coherence`: grid, wavelength, iota, kind, spectrum, wavelengths,
            seed.

        Returns
        -------
        CoherencePlan
            Plan with the light, ready for use.
        """
        check_keywords(options, keywords_of(plan_coherence), "Coherence.plan")
        return plan_coherence(cls, system, snr=snr, **options)

    def _check(self, system: System, objects: list[Field]) -> None:
        """Raise if the grid cannot sample the light, or the light misses the system."""
        if self.spatial is None:
            return
        by_wavelength = sorted(objects, key=lambda transmission: transmission.wavelength)
        ends = {transmission.wavelength: transmission for transmission in by_wavelength}
        for wavelength in dict.fromkeys([min(ends), max(ends)]):
            self.spatial.check(ends[wavelength].grid, wavelength=wavelength)
            check_reach(system, ends[wavelength], self.spatial)

    def _lit(self, transmission: Field, index: int) -> Field:
        """Return an object illuminated by a snapshot."""
        if self.spatial is None:
            return transmission
        light = self.light(
            transmission.grid,
            wavelength=transmission.wavelength,
            device=transmission.device,
            index=index,
        )
        return multiply(light, transmission.data)

    def _monte_carlo(
        self, system: System, objects: list[Field], shares: list[float], settings: Averaging
    ) -> MeanIntensity:
        number = len(objects)
        first = system(self._lit(objects[0], 0))
        require_image(first)
        computed = {0: first} if number == 1 else {}

        def snapshot(index: int) -> Field | cla.Array:
            if index in computed:
                return computed.pop(index)
            fields = (
                system(self._lit(transmission, index * number + line))
                for line, transmission in enumerate(objects)
            )
            return next(fields) if number == 1 else weighted(fields, shares)[0].data

        setup = self._setup(objects, shares, first) if settings.checkpoint is not None else {}
        return average(snapshot, first.grid, first.device, settings, setup)

    def _setup(self, objects: list[Field], shares: list[float], image: Field) -> dict[str, str]:
        """Return the strings that a checkpoint compares; its label stands for the system."""
        device = image.device
        samples = hashlib.sha256()
        for transmission, share in zip(objects, shares, strict=True):
            samples.update(f"{transmission.wavelength}, {share}".encode())
            samples.update(np.ascontiguousarray(transmission.to_numpy()).tobytes())
        return {
            "spatial model": repr(self.spatial),
            "spectrum": repr(self.spectrum),
            "seed": str(self.seed),
            "grid": repr(objects[0].grid),
            "object": f"samples and wavelengths of digest {samples.hexdigest()[:16]}",
            "image grid": repr(image.grid),
            "device": f"{device.name}, {device.driver}, {device.precision}, {device.fft.name}",
        }


def _wavelength_of(field: Object, spectrum: Spectrum | None) -> float:
    if isinstance(field, Field):
        return field.wavelength
    if not callable(field):
        raise TypeError(
            f"field must be a Field or a function of the wavelength, got {type(field).__name__}."
        )
    if spectrum is None:
        raise ValueError("A field that is a function of the wavelength requires a spectrum.")
    return spectrum.centre


def _object_at(field: Object, wavelength: float) -> Field:
    transmission = (
        replace(field, wavelength=wavelength) if isinstance(field, Field) else field(wavelength)
    )
    if not isinstance(transmission, Field):
        raise TypeError(
            f"The object's function must return a Field, got {type(transmission).__name__}."
        )
    if len(transmission.shape) != 2:
        raise ShapeError(
            f"Partially coherent light requires a single object of shape (ny, nx), got a batch of "
            f"shape {transmission.shape}."
        )
    return replace(transmission, wavelength=wavelength)
