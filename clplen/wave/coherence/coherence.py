"""Partially coherent light: a spatial model, a spectrum, and averages of what they light."""

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
    DEFAULT,
    Averaging,
    Checkpoint,
    Progress,
    average,
    named,
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
FOR_IMAGES, FOR_TABLES = 9, 41  # wavelengths
MANY = 15  # from which a Gaussian is sampled over +-2 full widths, fewer over +-1.5


@dataclass(frozen=True, repr=False)
class Coherence(OneLine):
    """Light between a laser and an ideal lamp.

    Parameters
    ----------
    spatial : RandomPhaseMask, ExtendedSource or IncoherentLight, optional
        Any `SpatialModel`; None: a plane wave, coherent across the field.
    spectrum : Spectrum, optional
        None: the wavelength of the field that is lit.
    wavelengths : int, optional
        Into which the spectrum is sampled; by default 9, enough for images, or 41 of a tabulated
        one. Interferometers need 21 or more: see `Spectrum.needed`. Every line keeps at least one.
    seed : int
        Of the snapshots, 0 to 2^64 - 1.

    Raises
    ------
    TypeError
        If ``spatial`` is no model or ``spectrum`` no `Spectrum`.
    ValueError
        For a number of wavelengths below 1 or a seed out of range.

    Notes
    -----
    Wavelengths are mutually incoherent: a snapshot is the weighted sum of the intensities at all of
    them, each lit by a snapshot of the spatial model of its own. Elements act as path lengths: they
    are given the field at its wavelength.

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
                "spatial is a RandomPhaseMask, an ExtendedSource or IncoherentLight(), not "
                f"{self.spatial!r}."
            )
        if self.spectrum is not None and not isinstance(self.spectrum, Spectrum):
            raise TypeError(f"spectrum is a Spectrum, not {self.spectrum!r}.")
        number = 1 if self.wavelengths is None else self.wavelengths
        if not isinstance(number, (int, np.integer)) or isinstance(number, bool) or number < 1:
            raise ValueError(f"wavelengths is a whole number from 1 on, not {number!r}.")
        check_seed(self.seed)

    @property
    def is_random(self) -> bool:
        """Whether snapshots differ."""
        return self.spatial is not None and self.spatial.random

    def lines(self, wavelength: float) -> list[tuple[float, float]]:
        """Wavelengths in metres and their shares of the power, which add up to 1.

        Parameters
        ----------
        wavelength : float
            In metres, where there is no spectrum.

        Returns
        -------
        list of tuple of float
        """
        if self.spectrum is None:
            return [(float(wavelength), 1.0)]
        default = FOR_TABLES if isinstance(self.spectrum.shape, Table) else FOR_IMAGES
        number = self.wavelengths or default
        samples = self.spectrum.sample(number, span=1.5 if number < MANY else 2.0)
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
        """Snapshots of the light in a plane, one after the other on the device.

        Parameters
        ----------
        grid : Grid
        device : Device or str, optional
            Default ``Device.open()``.
        wavelength : float, optional
            In metres; by default the centre of the spectrum. Snapshots are of one wavelength.
        start : int
            Number of the first.
        count : int, optional
            How many; by default without end.

        Yields
        ------
        Field
            Shape (ny, nx), of mean intensity 1. The same for the same number on every device.

        Raises
        ------
        SamplingError
            If the grid does not carry the light.
        """
        device = as_device(device)
        if wavelength is None:
            if self.spectrum is None:
                raise ValueError("Snapshots of light without a spectrum need wavelength=.")
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
        """Snapshot number ``index`` by itself; see `snapshots`."""
        if self.spatial is None:
            return plane_wave(grid, wavelength=wavelength, device=device)
        if not 0 <= index <= LARGEST_INDEX:
            raise ValueError(f"The number of a snapshot is 0 to 2^32 - 1, not {index!r}.")
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
        """The mean intensity behind a system whose object this light illuminates.

        Parameters
        ----------
        system : callable
            Field -> Field: an `OpticalSystem` or one part of it, a `Propagator`, a function.
        field : Field or callable
            The object's complex transmission, shape (ny, nx), the same at every wavelength; or a
            function of the wavelength in metres that gives it.
        snapshots : int, optional
            Number of snapshots; by default 100, or as many as ``rtol`` needs, at most 100 000.
        rtol : float, optional
            Standard error over mean in the region at which the average stops.
        region : tuple of slice, optional
            (rows, columns) of the image that ``rtol`` is measured in; by default all.
        checkpoint : path or (path, str), optional
            File that an interrupted average continues from, and a label of the system. Light,
            object, grids and device are compared with those of the file, and so is the label: the
            system is not, give each system its own label.
        progress : callable, optional
            Called with the number of snapshots so far and the largest number.
        method : {"auto", "monte-carlo", "abbe"}
            "monte-carlo" adds snapshots; "abbe" sums over the source, exact for systems that are
            shift-invariant in a periodic window; "auto" takes the sum where it is exact and
            affordable, else snapshots.

        Returns
        -------
        MeanIntensity

        Raises
        ------
        SamplingError
            If the grid does not carry the light, no light of the edge of the object reaches the
            first lens, or "abbe" is asked for a system that is not shift-invariant.
        FormatError
            If the checkpoint is damaged or of another set-up.
        """
        if not callable(system):
            system = OpticalSystem([system])
        how = Averaging(snapshots, rtol, region, checkpoint, progress)
        if method not in METHODS:
            raise ValueError(f"The method is one of {', '.join(METHODS)}, not {method!r}.")
        if checkpoint is not None:
            verify(named(checkpoint)[0])
        lines = self.lines(_wavelength_of(field, self.spectrum))
        objects = [_object_at(field, lam) for lam, _ in lines]
        shares = [share for _, share in lines]
        self._check(system, objects)
        if self.spatial is None or not self.is_random:
            lit = (system(self._lit(transmission, 0)) for transmission in objects)
            image, grid = weighted(lit, shares)
            Window.of(region, grid.shape)
            return without_noise(image, grid, "coherent", len(lines))
        if method != "monte-carlo":
            forced = method == "abbe"
            exact = sum_over_source(self.spatial, system, objects, shares, how, forced=forced)
            if exact is not None:
                return exact
        return self._monte_carlo(system, objects, shares, how)

    def vjp(
        self,
        system: OpticalSystem | Part,
        field: Field,
        *,
        snapshots: int = DEFAULT,
        parameters: Iterable[int] = (),
        method: Method = "auto",
    ) -> tuple[MeanIntensity, MeanPullback]:
        """The mean intensity behind a system, and what takes gradients back through it.

        Parameters
        ----------
        system : OpticalSystem or Part
            Its parts have adjoints.
        field : Field
            The object's transmission, shape (ny, nx), the same at every wavelength.
        snapshots : int
            Of `average`. Gradients are those of the mean of these snapshots.
        parameters : iterable of int
            Numbers of the parts whose parameters have gradients, from 0.
        method : {"auto", "monte-carlo", "abbe"}
            As in `average`.

        Returns
        -------
        MeanIntensity
            As `average` returns it.
        MeanPullback
            Takes the gradient by that intensity. It holds the field behind the system of each
            snapshot, up to a quarter of the device's memory, and none with ``parameters`` or where
            the sum is exact; those are computed again.

        Raises
        ------
        ShapeError
            For a batch of objects.
        """
        return mean_vjp(
            self, system, field, snapshots=snapshots, parameters=parameters, method=method
        )

    @classmethod
    def plan(cls, system: Any, *, snr: float, **options: Any) -> CoherencePlan[Coherence]:
        """Mask, snapshots and wavelengths for a wanted signal-to-noise ratio.

        Parameters
        ----------
        system, snr, **options
            As `plan_coherence` takes them: grid, wavelength, iota, kind, spectrum, wavelengths,
            seed.

        Returns
        -------
        CoherencePlan
        """
        check_keywords(options, keywords_of(plan_coherence), "Coherence.plan")
        return plan_coherence(cls, system, snr=snr, **options)

    def _check(self, system: System, objects: list[Field]) -> None:
        """Refuse light that the grid does not carry or that misses the system, at both ends."""
        if self.spatial is None:
            return
        by_wavelength = sorted(objects, key=lambda transmission: transmission.wavelength)
        ends = {transmission.wavelength: transmission for transmission in by_wavelength}
        for wavelength in dict.fromkeys([min(ends), max(ends)]):
            self.spatial.check(ends[wavelength].grid, wavelength=wavelength)
            check_reach(system, ends[wavelength], self.spatial)

    def _lit(self, transmission: Field, index: int) -> Field:
        """An object lit by one snapshot."""
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
        self, system: System, objects: list[Field], shares: list[float], how: Averaging
    ) -> MeanIntensity:
        number = len(objects)
        first = system(self._lit(objects[0], 0))
        require_image(first)
        ahead = {0: first} if number == 1 else {}

        def snapshot(index: int) -> Field | cla.Array:
            if index in ahead:
                return ahead.pop(index)
            fields = (
                system(self._lit(transmission, index * number + line))
                for line, transmission in enumerate(objects)
            )
            return next(fields) if number == 1 else weighted(fields, shares)[0].data

        setup = self._setup(objects, shares, first) if how.checkpoint is not None else {}
        return average(snapshot, first.grid, first.device, how, setup)

    def _setup(self, objects: list[Field], shares: list[float], image: Field) -> dict[str, str]:
        """What a checkpoint compares by itself; its label stands for the system."""
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
            f"The object is a Field, or a function of the wavelength, not {type(field).__name__}."
        )
    if spectrum is None:
        raise ValueError("An object that is a function of the wavelength needs a spectrum.")
    return spectrum.centre


def _object_at(field: Object, wavelength: float) -> Field:
    transmission = (
        replace(field, wavelength=wavelength) if isinstance(field, Field) else field(wavelength)
    )
    if not isinstance(transmission, Field):
        raise TypeError(
            f"The object's function returns a Field, not {type(transmission).__name__}."
        )
    if len(transmission.shape) != 2:
        raise ShapeError(
            f"Partially coherent light illuminates one object of shape (ny, nx), not a batch of "
            f"shape {transmission.shape}."
        )
    return replace(transmission, wavelength=wavelength)
