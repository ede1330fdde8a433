"""Several plenoptic cameras measured alike."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.camera_psf import PLACES, Done, camera_psf, psf_exposures
from clplen.analysis.depthscan import PLACES as DEPTH_PLACES
from clplen.analysis.depthscan import default_depths, depth_scan
from clplen.analysis.measured import Measured
from clplen.analysis.rendered import as_seen
from clplen.analysis.samples import Values
from clplen.analysis.sampling import sampling_of
from clplen.analysis.straylight import camera_crosstalk
from clplen.cameras.plenoptic import Plenoptic
from clplen.cameras.scenes.scene_sources import PointSources, as_sources
from clplen.errors import SamplingError
from clplen.reprs import OneLine

ANALYSES = (
    "sampling",
    "psf",
    "mtf",
    "two-points",
    "strehl",
    "energy",
    "crosstalk",
    "transfer",
    "depth",
    "pictures",
)
OF_PSF = ("psf", "mtf", "two-points", "strehl", "energy")
OVER_DEPTH = ("transfer", "depth")
QUICK = 3  # places of a point below a lenslet, in place of `PLACES`
_CLOSE = 0.5  # of a name that is meant, as difflib counts

Progress = Callable[[int, int], Any]


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(OneLine):
    """Cameras measured alike. Made by `compare`.

    Attributes
    ----------
    cameras : tuple of Measured
    analyses : tuple of str
        What was asked for, out of `ANALYSES`.
    """

    cameras: tuple[Measured, ...]
    analyses: tuple[str, ...]

    def __getitem__(self, name: str) -> Measured:
        """What was measured of the camera of this name.

        Raises
        ------
        KeyError
            Listing the names there are.
        """
        for one in self.cameras:
            if one.name == name:
                return one
        raise KeyError(f"no camera {name!r}; there are {', '.join(c.name for c in self.cameras)}")


def compare(
    cameras: Mapping[str, Plenoptic],
    *,
    only: Iterable[str] | None = None,
    depths: Sequence[float] | Values | None = None,
    scenes: Mapping[str, Any] | None = None,
    quick: bool = False,
    progress: Progress | None = None,
) -> Comparison:
    """Measure plenoptic cameras in the same way: resolution, samples, crosstalk, depth.

    What is simulated for each camera: `camera_psf` (15 exposures of a point by a 1.0 camera whose
    array is its own mirror image, 81 by another one, 4 by a 2.0 camera), `camera_crosstalk` (1),
    `depth_scan` (3 for each depth), and its scene.

    Parameters
    ----------
    cameras : mapping of str to Plenoptic
        By name, 1.0 and 2.0.
    only : iterable of str, optional
        Out of `ANALYSES`; default all, "pictures" where there are scenes.
    depths : array_like, optional
        dz in metres; default seven from -15 to 15 % of the first camera's object distance.
    scenes : mapping of str to scene, optional
        For "pictures", what each camera looks at, as `Plenoptic.expose` takes it.
    quick : bool
        Fewer places below a lenslet, 3 for 9, and three depths.
    progress : callable, optional
        Called as ``progress(done, total)`` for exposures.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        If there is no camera, an analysis is unknown (with the nearest known one), "pictures" is
        asked for without a scene for every camera, or a depth cannot be.
    TypeError
        If they are no mapping of names to cameras.
    SamplingError, DeviceError
        As `Plenoptic.expose`.
    """
    _require_cameras(cameras)
    wanted = _wanted(only, cameras, scenes)
    if scenes is not None and "pictures" in wanted:
        for name, camera in cameras.items():
            with told_of(name):
                _check_scene(camera, scenes[name])
    if depths is None:
        depths = default_depths(next(iter(cameras.values())), quick=quick)
    plan = _Plan(wanted, np.asarray(depths, np.float64), QUICK if quick else PLACES)
    total = sum(plan.exposures(camera) for camera in cameras.values())
    count = 0

    def done(more: int) -> None:
        nonlocal count
        count += more
        if progress is not None:
            progress(count, total)

    found = []
    for name, camera in cameras.items():
        with told_of(name):
            scene = None if scenes is None else scenes.get(name)
            found.append(plan.measure(name, camera, scene, done))
    return Comparison(tuple(found), wanted)


@contextmanager
def told_of(name: str) -> Iterator[None]:
    """Put the name of a camera before what is said about it."""
    try:
        yield
    except (ValueError, SamplingError) as error:
        raise type(error)(f"{name}: {error}") from error


def known_analyses(names: Iterable[str]) -> tuple[str, ...]:
    """These names, in the order of `ANALYSES`.

    Raises
    ------
    ValueError
        If one is unknown, with the nearest known one; or there is none.
    """
    asked = list(names)
    for name in asked:
        if name not in ANALYSES:
            near = difflib.get_close_matches(name, ANALYSES, 1, _CLOSE)
            meant = f" Did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"There is no analysis {name!r} of {', '.join(ANALYSES)}.{meant}")
    if not asked:
        raise ValueError(f"Name at least one analysis of {', '.join(ANALYSES)}.")
    return tuple(name for name in ANALYSES if name in asked)


def _require_cameras(cameras: Any) -> None:
    if not isinstance(cameras, Mapping):
        raise TypeError(f"Cameras are given as {{name: camera}}, not as {type(cameras).__name__}.")
    if not cameras:
        raise ValueError("A comparison needs at least one camera.")
    for name, camera in cameras.items():
        if not isinstance(camera, Plenoptic):
            raise TypeError(
                f"{name}: a camera is PlenopticCamera.type1(...) or type2(...), not "
                f"{type(camera).__name__}."
            )


def _wanted(
    only: Iterable[str] | None, cameras: Mapping[str, Plenoptic], scenes: Mapping[str, Any] | None
) -> tuple[str, ...]:
    missing = [name for name in cameras if name not in (scenes or {})]
    if only is None:
        return tuple(name for name in ANALYSES if name != "pictures" or not missing)
    wanted = known_analyses(only)
    if "pictures" in wanted and missing:
        raise ValueError(f"For 'pictures' give a scene of every camera; {missing[0]!r} has none.")
    return wanted


def _check_scene(camera: Plenoptic, scene: Any) -> None:
    """Refuse a scene that a camera cannot show, before anything is simulated."""
    for part in as_sources(scene):
        camera.check_scene(part if isinstance(part, PointSources) else part.corners())


@dataclass(frozen=True)
class _Plan:
    """What is done with every camera."""

    wanted: tuple[str, ...]
    depths: Values
    places: int

    def exposures(self, camera: Plenoptic) -> int:
        return (
            self._asks(OF_PSF) * psf_exposures(camera, self.places)
            + self._asks(("crosstalk",))
            + self._asks(OVER_DEPTH) * len(self.depths) * DEPTH_PLACES
            + self._asks(("pictures",))
        )

    def measure(self, name: str, camera: Plenoptic, scene: Any, done: Done) -> Measured:
        psf = light = picture = None
        transfer, depth = None, None
        sampling = sampling_of(camera)
        if self._asks(OF_PSF):
            psf = camera_psf(camera, places=self.places, done=done)
        if self._asks(("crosstalk",)):
            light = camera_crosstalk(camera)
            done(1)
        if self._asks(OVER_DEPTH):
            transfer, depth = depth_scan(
                camera,
                self.depths,
                transfer="transfer" in self.wanted,
                errors="depth" in self.wanted,
                done=done,
            )
        if self._asks(("pictures",)):
            picture = as_seen(camera.expose(scene))
            done(1)
        return Measured(name, camera, sampling, psf, light, transfer, depth, picture)

    def _asks(self, names: Sequence[str]) -> bool:
        return any(name in self.wanted for name in names)
