"""The settings of a deconvolution, for Python, for jobs and for the command line."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from clplen.files import PathLike, naming
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy.frames.given_lattice import check_given, square_lattice
from clplen.reprs import one_line
from clplen.settings.declaration import SettingError, Settings, named, setting, settings_of

OF_FRAMES = (  # fields on which the volume of a frame depends by itself
    "iterations", "background", "gain", "saturation", "haze", "residual", "accelerate", "prior",
    "strength", "radiometric", "keep_hot",
)  # fmt: skip


@dataclass(frozen=True, repr=False)
class DeconvolutionSettings(Settings):
    """Settings of a deconvolution, on which the volumes depend.

    Attributes
    ----------
    iterations : int
        Number of Richardson-Lucy iterations.
    background : float
        Uniform background in counts of a pixel of the camera, above the dark level.
    gain : float or None
        Counts of a photon; None takes each count as a photon.
    saturation : float or None
        Level from which on pixels are left out; None is the largest of an integer type.
    haze : bool
        Whether light from far beyond the volume is subtracted; see `Preparation.haze`.
    residual, accelerate, prior, strength
        As of `deconvolve`; prior "time" only of a series. ``strength`` None is 1.
    radiometric : bool
        Whether what the modelled pupil lacks beside the white frame goes into the sensitivity; see
        `clplen.microscopy.corrected`.
    keep_hot : bool
        Whether hot pixels are kept; otherwise they are left out.
    start, motion, batch, rolling
        As of `deconvolve_series`; None where there is no series.

    Raises
    ------
    ValueError
        If a value is out of range, or one is given without the setting that it belongs to.

    Examples
    --------
    >>> how = clplen.microscopy.DeconvolutionSettings(iterations=40, gain=2.2, prior="tv")
    >>> how.iterations, how.background, how.prior
    (40, 0.0, 'tv')
    """

    iterations: int = setting(
        20, "Number of Richardson-Lucy iterations.", kind=int, minimum=1, flags=("--max-iter",)
    )
    background: float = setting(
        0.0,
        "Uniform background, in counts above the dark level.",
        minimum=0,
        flags=("--background-level",),
    )
    gain: float | None = setting(
        None, "Counts of a photon, for the residual noise and for priors.", above=0,
        default_text="1", example=2.2,
    )  # fmt: skip
    saturation: float | None = setting(
        None,
        "Level from which on pixels are left out.",
        above=0,
        default_text="the largest of an integer type",
        example=4095.0,
    )
    haze: bool = setting(
        False,
        "Subtract light from far beyond the volume: the white frame, as dark as in the darkest "
        "lenslets.",
        kind=bool,
    )
    residual: float | Literal["noise"] | None = setting(
        None,
        "Stop when the residual is below this number, or below that of photon noise.",
        above=0,
        choices=("noise",),
        metavar="NUMBER|noise",
        example=0.01,
    )
    accelerate: bool = setting(
        False, "Take fewer iterations, with memory for four more volumes.", kind=bool
    )
    prior: Literal["tv", "gaussian", "time"] | None = setting(
        None,
        "tv: against noise; gaussian: nothing finer than a lenslet about the native plane; time: "
        "voxels of a series seldom change.",
        kind=str,
        choices=("tv", "gaussian", "time"),
        example="tv",
    )
    strength: float | None = setting(
        None, "Strength of the prior.", above=0, default_text="1", example=1.0
    )
    radiometric: bool = setting(
        False, "Correct the pupil of the point images by the white frame.", kind=bool
    )
    keep_hot: bool = setting(False, "Keep hot pixels.", kind=bool)
    start: Literal["previous", "decayed", "limited"] | None = setting(
        None,
        "Begin a frame of a series with the volume before: as it is, with half its contrast, or as "
        "wide as things move.",
        kind=str,
        choices=("previous", "decayed", "limited"),
        example="limited",
    )
    motion: float | None = setting(
        None,
        "Motion from frame to frame for start limited, in micrometres.",
        above=0,
        unit="um",
        default_text="half a voxel",
        example=1.0,
    )
    batch: int | None = setting(
        None, "Number of frames of a series that are found together.", kind=int, minimum=1,
        default_text="8, or fewer where memory is scarce", example=8,
    )  # fmt: skip
    rolling: int | None = setting(
        None,
        "Number of frames of a series over which the minimum of each pixel is background.",
        kind=int,
        minimum=1,
        flags=("--rolling-background",),
        metavar="N",
        example=9,
    )

    def __repr__(self) -> str:
        known = {one.name: getattr(self, one.name) for one in settings_of(self)}
        return one_line(self, {k: v for k, v in known.items() if v not in (None, False)})

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.strength is not None and self.prior is None:
            raise SettingError(
                "strength", f"needs {named('prior')}: give tv, gaussian or time, or leave it out"
            )
        if self.motion is not None and self.start != "limited":
            raise SettingError(
                "motion", f"needs {named('start')} limited: give it, or leave both out", "motion_um"
            )

    def require_white(self, is_given: bool) -> None:
        """Refuse settings that need a white frame where there is none."""
        for name in ("haze", "radiometric"):
            if getattr(self, name) and not is_given:
                raise SettingError(name, f"needs the white frame: give {named('white')}")

    def require_series(self, is_series: bool, *, in_turn: bool) -> None:
        """Refuse settings of a series where frames are found alone, ``in_turn`` or anyhow."""
        if is_series:
            return
        if self.start is not None and not in_turn:
            raise SettingError("start", "needs frames one after the other: leave it out")
        if self.prior == "time":
            raise SettingError("prior", "time needs a series of frames in one file")
        for name in ("batch", "rolling"):
            if getattr(self, name) is not None:
                raise SettingError(name, "needs a series of frames in one file")

    @property
    def of_frames(self) -> dict[str, Any]:
        """Values on which the volume of a frame depends by itself, defaults filled in."""
        values = {name: getattr(self, name) for name in OF_FRAMES}
        return values | {"gain": self.gain or 1.0, "strength": self.strength or 1.0}


@dataclass(frozen=True)
class LatticeSettings(Settings):
    """Pixels that are left out, and the lattice of frames that have no white frame."""

    mask: str | None = setting(
        None, "Picture that is not 0 where pixels are left out.", kind=Path, example="mask.png"
    )
    lattice: str | None = setting(
        None, "JSON file of the lattice, where there is no white frame.", kind=Path,
        example="lattice.json",
    )  # fmt: skip
    pitch: float | None = setting(
        None, "Pitch of a square lattice in pixels, where there is no white frame.", above=0,
        example=15.4,
    )  # fmt: skip
    offset: tuple[float, float] | None = setting(
        None,
        "Centre of a lenslet in pixels, whose centres are integers.",
        pair=True,
        metavar="Y:X",
        default_text="in the corner",
        example=[7.2, 7.2],
    )
    rotation: float | None = setting(
        None, "Angle of the lattice in degrees, from +x towards +y.", default_text="0",
        example=-0.1,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("offset", "rotation"):
            if getattr(self, name) is not None and self.pitch is None:
                raise SettingError(name, f"needs the pitch of the lattice: give {named('pitch')}")
        if self.lattice is not None and self.pitch is not None:
            self._refuse_both("pitch", "lattice")

    @property
    def has_lattice(self) -> bool:
        """Whether a lattice is given."""
        return self.lattice is not None or self.pitch is not None

    def require_no_white(self, is_given: bool) -> None:
        """Refuse a lattice beside a white frame."""
        for name in ("lattice", "pitch"):
            if getattr(self, name) is not None and is_given:
                self._refuse_both(name, "white")

    def _refuse_both(self, name: str, other: str) -> None:
        raise SettingError(name, f"and {named(other)} both give the lattice: give one of them")

    def of_frame(self, shape: tuple[int, int], frame: PathLike) -> Lattice | None:
        """Return the lattice on frames of a shape, None without one."""
        if self.pitch is not None:
            with naming(frame):
                return square_lattice(
                    self.pitch, shape, offset=self.offset,
                    rotation=math.radians(self.rotation or 0.0),
                )  # fmt: skip
        if self.lattice is None:
            return None
        found = Lattice.load(Path(self.lattice))
        if found.shape is None:
            found = replace(found, shape=shape)
        with naming(self.lattice):
            check_given(found)
        return found
