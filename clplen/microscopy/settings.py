"""Settings of a deconvolution, for Python, for jobs and for the command line."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from clplen.files import PathLike, naming
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy.frames.nominal_lattice import check_lattice, square_lattice
from clplen.reprs import one_line
from clplen.settings.declaration import SettingError, Settings, named, setting, settings_of

FRAME_SETTINGS = (  # settings that determine the volume of a single frame
    "iterations", "background", "gain", "saturation", "haze", "residual", "accelerate", "prior",
    "strength", "radiometric", "keep_hot",
)  # fmt: skip


@dataclass(frozen=True, repr=False)
class DeconvolutionSettings(Settings):
    """Settings that determine the volumes of a deconvolution.

    Attributes
    ----------
    iterations : int
        Number of Richardson-Lucy iterations.
    background : float
        Uniform background in counts per camera pixel, above the dark level.
    gain : float or None
        Counts per photon; None counts each count as a photon.
    saturation : float or None
        Level from which on pixels are excluded; None is the maximum of an integer type.
    haze : bool
        True to subtract light from far beyond the volume; see `Preparation.haze`.
    residual, accelerate, prior, strength
        Options of `deconvolve`; the prior "time" requires a series. ``strength`` None is 1.
    radiometric : bool
        True to correct the pixel sensitivity by the ratio of the white frame to the modelled
        pupil; see `clplen.microscopy.corrected`.
    keep_hot : bool
        True to keep hot pixels, False to exclude them.
    start, motion, batch, rolling
        Options of `deconvolve_series`; None without a series.

    Raises
    ------
    ValueError
        If a value is out of range, or a setting is given without the setting that it modifies.

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
        None, "Counts per photon; the residual 'noise' and the priors tv and time depend on it.",
        above=0, default_text="1", example=2.2,
    )  # fmt: skip
    saturation: float | None = setting(
        None,
        "Saturation level; pixels at or above it are excluded.",
        above=0,
        default_text="the maximum of an integer type",
        example=4095.0,
    )
    haze: bool = setting(
        False,
        "Subtract haze, light from far beyond the volume: the white frame scaled to the darkest "
        "lenslets.",
        kind=bool,
    )
    residual: float | Literal["noise"] | None = setting(
        None,
        "Stop when the residual falls below this number, or below the residual of photon noise.",
        above=0,
        choices=("noise",),
        metavar="NUMBER|noise",
        example=0.01,
    )
    accelerate: bool = setting(
        False, "Accelerate the iterations; needs memory for four more volumes.", kind=bool
    )
    prior: Literal["tv", "gaussian", "time"] | None = setting(
        None,
        "Prior. tv: small total variation, against noise; gaussian: no detail finer than a lenslet "
        "near the native plane; time: voxels of a series change rarely.",
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
        "Initial volume of a frame of a series, from the previous volume: unchanged, with half its "
        "contrast, or smoothed by the motion.",
        kind=str,
        choices=("previous", "decayed", "limited"),
        example="limited",
    )
    motion: float | None = setting(
        None,
        "Motion between successive frames for the start 'limited', in micrometres.",
        above=0,
        unit="um",
        default_text="half a voxel",
        example=1.0,
    )
    batch: int | None = setting(
        None, "Number of frames of a series that are deconvolved together.", kind=int, minimum=1,
        default_text="8, or fewer where memory is scarce", example=8,
    )  # fmt: skip
    rolling: int | None = setting(
        None,
        "Number of frames in a rolling window; the minimum of each pixel over it is background.",
        kind=int,
        minimum=1,
        flags=("--rolling-background",),
        metavar="N",
        example=9,
    )

    def __repr__(self) -> str:
        values = {option.name: getattr(self, option.name) for option in settings_of(self)}
        return one_line(self, {k: v for k, v in values.items() if v not in (None, False)})

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

    def require_white(self, has_white: bool) -> None:
        """Raise SettingError if a setting needs a white frame that is missing."""
        for name in ("haze", "radiometric"):
            if getattr(self, name) and not has_white:
                raise SettingError(name, f"needs the white frame: give {named('white')}")

    def require_series(self, is_series: bool, *, in_turn: bool) -> None:
        """Raise SettingError if a setting needs a series and the frames are deconvolved singly.

        ``in_turn`` is the flag that each frame may start with the volume of the previous frame.
        """
        if is_series:
            return
        if self.start is not None and not in_turn:
            raise SettingError("start", "needs successive frames: leave it out")
        if self.prior == "time":
            raise SettingError("prior", "time needs a series of frames in one file")
        for name in ("batch", "rolling"):
            if getattr(self, name) is not None:
                raise SettingError(name, "needs a series of frames in one file")

    @property
    def frame_settings(self) -> dict[str, Any]:
        """Settings that determine the volume of a single frame, with defaults filled in."""
        values = {name: getattr(self, name) for name in FRAME_SETTINGS}
        return values | {"gain": self.gain or 1.0, "strength": self.strength or 1.0}


@dataclass(frozen=True)
class LatticeSettings(Settings):
    """Mask of excluded pixels, and lattice of frames without a white frame."""

    mask: str | None = setting(
        None, "Mask picture; pixels with nonzero values are excluded.", kind=Path,
        example="mask.png",
    )  # fmt: skip
    lattice: str | None = setting(
        None, "JSON file of the lattice, for frames without a white frame.", kind=Path,
        example="lattice.json",
    )  # fmt: skip
    pitch: float | None = setting(
        None, "Pitch of a square lattice in pixels, for frames without a white frame.", above=0,
        example=15.4,
    )  # fmt: skip
    offset: tuple[float, float] | None = setting(
        None,
        "Centre of a lenslet in pixels; pixel centres have integer coordinates.",
        pair=True,
        metavar="Y:X",
        default_text="(pitch - 1)/2, a lenslet in the corner",
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
        """Flag that a lattice or its pitch is given."""
        return self.lattice is not None or self.pitch is not None

    def require_no_white(self, has_white: bool) -> None:
        """Raise SettingError if both a lattice and a white frame are given."""
        for name in ("lattice", "pitch"):
            if getattr(self, name) is not None and has_white:
                self._refuse_both(name, "white")

    def _refuse_both(self, name: str, other: str) -> None:
        raise SettingError(name, f"and {named(other)} both define the lattice: give one of them")

    def lattice_for(self, shape: tuple[int, int], frame: PathLike) -> Lattice | None:
        """Return the lattice for frames of a shape, or None if no lattice is given."""
        if self.pitch is not None:
            with naming(frame):
                return square_lattice(
                    self.pitch, shape, offset=self.offset,
                    rotation=math.radians(self.rotation or 0.0),
                )  # fmt: skip
        if self.lattice is None:
            return None
        lattice = Lattice.load(Path(self.lattice))
        if lattice.shape is None:
            lattice = replace(lattice, shape=shape)
        with naming(self.lattice):
            check_lattice(lattice)
        return lattice
