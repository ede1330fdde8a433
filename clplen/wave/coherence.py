"""Partially coherent light: a spatial model, a spectrum, and averages of what they light."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass, replace
from itertools import count as whole_numbers
from itertools import islice
from typing import Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.image import Image
from clplen.errors import SamplingError, ShapeError
from clplen.files import PathLike
from clplen.wave.abbe import abbe_cost, abbe_image, incoherent_image
from clplen.wave.average import Averaging, MeanIntensity, Progress, average, exact
from clplen.wave.checkpoint import fingerprint
from clplen.wave.field import Field, Grid
from clplen.wave.lineshapes import Table
from clplen.wave.multiply import multiply
from clplen.wave.planning import CoherencePlan, plan_coherence
from clplen.wave.pupil import transfer_of
from clplen.wave.random import LARGEST_INDEX, check_seed
from clplen.wave.reach import check_reach
from clplen.wave.sources import plane_wave
from clplen.wave.spatial import IncoherentLight, SpatialModel
from clplen.wave.spectrum import Spectrum
from clplen.wave.statistics import Region
from clplen.wave.system import OpticalSystem

System = Callable[[Field], Field]
Object = Field | Callable[[float], Field]
Method = Literal["auto", "monte-carlo", "abbe"]
METHODS = ("auto", "monte-carlo", "abbe")
FOR_IMAGES, FOR_TABLES = 9, 21  # wavelengths
MANY = 15  # from which a Gaussian is sampled over +-2 full widths, fewer over +-1.5

ABBE_FLOPS = 1e11  # that "auto" spends on an exact sum in any case: well below a minute on a CPU
ABBE_TIMES = 10.0  # and so many times what the snapshots would cost


@dataclass(frozen=True)
class Coherence:
    """Light between a laser and an ideal lamp.

    Parameters
    ----------
    spatial : RandomPhaseMask, ExtendedSource or IncoherentLight, optional
        Any `SpatialModel`; None: a plane wave, coherent across the field.
    spectrum : Spectrum, optional
        None: the wavelength of the field that is lit.
    wavelengths : int, optional
        Into which the spectrum is sampled; by default 9, enough for images, or 21 of a tabulated
        one. Interferometers need 21 or more: see `Spectrum.needed`.
    seed : int
        Of the snapshots, 0 to 2^64 - 1.

    Raises
    ------
    TypeError
        If ``spatial`` is no model or ``spectrum`` no `Spectrum`.
    ValueError
        For a number of wavelengths below 1 or a seed out of range.

    Examples
    --------
    >>> light = Coherence(RandomPhaseMask(40e-6), Spectrum.gaussian(550e-9, 30e-9))
    >>> image = system(field, coherence=light, snapshots=300)
    >>> image.intensity, image.standard_error, image.snapshots, image.convergence

    Notes
    -----
    Wavelengths are mutually incoherent: a snapshot is the weighted sum of the intensities at all of
    them, each lit by a snapshot of the spatial model of its own. Elements act as path lengths: they
    are given the field at its wavelength.
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
        wavelength: float,
        device: Device,
        start: int = 0,
        count: int | None = None,
    ) -> Iterator[Field]:
        """Snapshots of the light in a plane, one after the other on the device.

        Parameters
        ----------
        grid : Grid
        wavelength : float
            In metres.
        device : Device
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
        if self.spatial is not None:
            self.spatial.check(grid, wavelength=wavelength)
        return (
            self.light(grid, wavelength=wavelength, device=device, index=index)
            for index in islice(whole_numbers(start), count)
        )

    def light(self, grid: Grid, *, wavelength: float, device: Device, index: int) -> Field:
        """Snapshot number ``index`` by itself; see `snapshots`."""
        if self.spatial is None:
            return plane_wave(grid, wavelength=wavelength, device=device)
        if not 0 <= index <= LARGEST_INDEX:
            raise ValueError(f"The number of a snapshot is 0 to 2^32 - 1, not {index!r}.")
        return self.spatial.field(
            grid, wavelength=wavelength, device=device, seed=self.seed, index=index
        )

    def average(
        self,
        system: System,
        field: Object,
        *,
        snapshots: int | None = None,
        rtol: float | None = None,
        region: Region | None = None,
        checkpoint: PathLike | None = None,
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
        snapshots, rtol, region, checkpoint, progress
            See `Averaging`. A checkpoint knows a plain function by its name alone: what it encloses
            is not compared.
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
        lines = self.lines(_wavelength_of(field, self.spectrum))
        objects = [_object_at(field, lam) for lam, _ in lines]
        if self.spatial is not None:
            self.spatial.check(objects[0].grid, wavelength=lines[0][0])
            check_reach(system, objects[0], self.spatial)
        shares = [share for _, share in lines]
        if not self.is_random:
            lit = [self._lit(thing, 0) for thing in objects]
            image, grid = _weighted([system(one) for one in lit], shares)
            return exact(image, grid, "coherent", len(lines))
        if method != "monte-carlo":
            found = self._exact(system, objects, shares, how, forced=method == "abbe")
            if found is not None:
                return found
        return self._monte_carlo(system, objects, shares, how)

    @classmethod
    def plan(cls, system: Any, *, snr: float, **options: Any) -> CoherencePlan:
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
        return plan_coherence(cls, system, snr=snr, **options)

    def _lit(self, thing: Field, index: int) -> Field:
        """An object lit by one snapshot."""
        if self.spatial is None:
            return thing
        light = self.light(
            thing.grid, wavelength=thing.wavelength, device=thing.device, index=index
        )
        return multiply(light, thing.data)

    def _monte_carlo(
        self, system: System, objects: list[Field], shares: list[float], how: Averaging
    ) -> MeanIntensity:
        number = len(objects)

        def snapshot(index: int) -> Field | cla.Array:
            fields = (
                system(self._lit(thing, index * number + place))
                for place, thing in enumerate(objects)
            )
            return next(fields) if number == 1 else _weighted(fields, shares)[0].data

        first = system(self._lit(objects[0], 0))
        _require_image(first)
        setup = self._setup(system, objects, first)
        return average(snapshot, first.grid, first.device, how, setup)

    def _exact(
        self,
        system: System,
        objects: list[Field],
        shares: list[float],
        how: Averaging,
        *,
        forced: bool,
    ) -> MeanIntensity | None:
        """The sum over the source, or None where "auto" does not take it."""
        assert self.spatial is not None
        transfers = [transfer_of(system, one.grid, one.wavelength) for one in objects]
        if any(transfer is None for transfer in transfers):
            if forced:
                raise SamplingError(
                    "method='abbe' sums over the source of a shift-invariant system, made of "
                    "Pupil and Space(method='as', pad=1) parts alone; for this system use "
                    "method='monte-carlo'."
                )
            return None
        incoherent = isinstance(self.spatial, IncoherentLight)
        images: list[Image] = []
        terms = 0
        for thing, transfer in zip(objects, transfers, strict=True):
            assert transfer is not None
            if incoherent:
                images.append(incoherent_image(thing, transfer))
                terms += 1
                continue
            source = self.spatial.power_spectrum(thing.grid, wavelength=thing.wavelength)
            if not forced and not self._affordable(thing, transfer, source, how):
                return None
            found = abbe_image(thing, transfer, source)
            images.append(found.intensity)
            terms += found.terms
        total = _sum(images, shares)
        return exact(total, objects[0].grid, "incoherent" if incoherent else "abbe", terms)

    def _affordable(
        self, thing: Field, transfer: np.ndarray[Any, Any], source: Any, how: Averaging
    ) -> bool:
        """Whether "auto" takes the sum over the source."""
        if not getattr(self.spatial, "degree_is_exact", True):
            return False
        samples = thing.grid.shape[0] * thing.grid.shape[1]
        one = 4 * 5 * samples * np.log2(samples)  # a snapshot's two transforms, and the system's
        limit = max(ABBE_FLOPS, ABBE_TIMES * one * how.most if how.rtol is None else 0.0)
        return bool(abbe_cost(thing.grid, transfer, source) <= limit)

    def _setup(self, system: System, objects: list[Field], image: Field) -> dict[str, str]:
        """Everything that decides the bits of an average."""
        first = objects[0]
        sha = hashlib.sha256()
        for thing in objects:
            sha.update(thing.to_numpy().tobytes())
        return {
            "spatial model": fingerprint(self.spatial),
            "spectrum": fingerprint(self.spectrum),
            "wavelengths": str([thing.wavelength for thing in objects]),
            "seed": str(self.seed),
            "grid": str(first.grid),
            "object": sha.hexdigest()[:16],
            "system": fingerprint(system),
            "image grid": str(image.grid),
            "device": f"{first.device.name}, {first.device.driver}",
            "precision": first.device.precision,
            "FFT": first.device.fft.name,
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
    thing = replace(field, wavelength=wavelength) if isinstance(field, Field) else field(wavelength)
    if not isinstance(thing, Field):
        raise TypeError(f"The object's function returns a Field, not {type(thing).__name__}.")
    if len(thing.shape) != 2:
        raise ShapeError(
            f"Partially coherent light illuminates one object of shape (ny, nx), not a batch of "
            f"shape {thing.shape}."
        )
    return replace(thing, wavelength=wavelength)


def _require_image(field: object) -> None:
    if not isinstance(field, Field):
        raise TypeError(f"A system returns a Field, not {type(field).__name__}.")


def _weighted(fields: Any, shares: list[float]) -> tuple[Image, Grid]:
    """Sum of intensities with weights, and the grid they share."""
    total: cla.Array | None = None
    grid: Grid | None = None
    for field, share in zip(fields, shares, strict=True):
        _require_image(field)
        device = field.device
        if total is None or grid is None:
            total, grid = device.zeros(field.grid.shape, device.real), field.grid
        if field.grid != grid:
            raise ShapeError(
                f"The system's image has another grid at another wavelength, {field.grid} after "
                f"{grid}: give its last distance an out_grid."
            )
        ny, nx = grid.shape
        device.launch_rows(
            device.kernel("intensity.cl", "accumulate", **device.wave_defines()),
            grid.shape,
            total,
            field.data,
            device.upload(np.array([share], device.real)),
            np.int32(1),
            np.int32(ny),
            np.int32(nx),
        )
    assert total is not None
    assert grid is not None
    return Image(total, device), grid


def _sum(images: list[Image], shares: list[float]) -> Image:
    """Images with weights, added up."""
    if len(images) == 1:
        return images[0]
    device = images[0].device
    total = sum(
        share * image.to_numpy().astype(np.float64)
        for image, share in zip(images, shares, strict=True)
    )
    return Image(device.upload(np.asarray(total, images[0].data.dtype)), device)
