"""Settings of operations on light fields: reading, stacks, depth maps, pictures and views.

Each model is a table of a job file, and the options of a command; its fields have the names of the
Python function's arguments.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import model_validator

from clplen.config.settings import INPUT, LENGTHS, PLANES, Aperture, Pair, Planes, Size, setting
from clplen.config.tables import Positive, Switch, Table

Interpolation = Literal["linear", "nearest", "cubic", "fourier"]
Cue = Literal["energy", "correspondence", "structure-tensor", "combined"]
_DISPARITIES = "Planes by disparity: pixels a view step, nearer is larger."
_ALPHAS = "Planes by alpha = F/F', where the light field knows its spacing."
_APERTURE = (
    "Part of the main lens to use: views across (9), fraction of the diameter (0.5) or f-number "
    "(f/66)."
)


class LayoutTable(Table):
    """``[inputs.layout]``: the arguments of `clplen.read_lightfield`."""

    pattern: str | None = setting(
        None,
        "Names of the views in a folder: {v} and {u} row and column, or {i} row by row; {n} a "
        "counter to ignore; * anything.",
        group=INPUT, default_text="guessed", example="view_{v}_{u}.png", metavar="NAMES",
    )  # fmt: skip
    views: Pair | None = setting(
        None, "Rows and columns of views, as the names count them.",
        group=INPUT, default_text="detected", example=[9, 9], metavar="V U",
    )  # fmt: skip
    swap_uv: Switch = setting(False, "The names count columns before rows.", group=INPUT)
    flip_v: Switch = setting(False, "Reverse the rows of views.", group=INPUT)
    flip_u: Switch = setting(False, "Reverse the columns of views.", group=INPUT)
    allow_missing: Switch = setting(
        False, "Give missing views the weight 0 instead of an error.", group=INPUT
    )
    order: str | None = setting(
        None,
        "Axes of an array (uvyxc); of a mosaic yvxu (lenslet images) or vyux (views side by side); "
        "lawnmower for names that count every other row backwards.",
        group=INPUT, default_text="detected", example="vuyx", metavar="AXES",
    )  # fmt: skip
    dataset: str | None = setting(
        None, "Name of the array in a file that holds several (HDF5, Zarr, .mat).",
        group=INPUT, default_text="detected", example="LF", metavar="NAME",
    )  # fmt: skip
    positions: str | None = setting(
        None,
        "Positions of the views on the aperture, in view steps: a table v,u,y,x, or 'names' for "
        "file names of the Stanford archive.",
        group=INPUT, default_text="a regular grid", example="names", metavar="CSV|names",
    )  # fmt: skip
    srgb: Switch = setting(False, "Decode sRGB to linear light.", group=INPUT)
    white: str | None = setting(
        None, "White image of a raw lenslet image.",
        group=INPUT, default_text="none", example="white.png", metavar="FILE",
    )  # fmt: skip
    dark: str | None = setting(
        None, "Dark frame of a raw lenslet image.",
        group=INPUT, default_text="none", example="dark.png", metavar="FILE",
    )  # fmt: skip
    calibration: str | None = setting(
        None, "White images of a Lytro camera: folder or tar archive.",
        group=INPUT, default_text="$CLPLEN_LYTRO, or the last one used for this camera",
        example="caldata.tar", metavar="FILE",
    )  # fmt: skip
    grid: str | None = setting(
        None, "Lenslet lattice: JSON of clplen or a Raytrix XML.",
        group=INPUT, default_text="detected", example="lattice.json", metavar="FILE",
    )  # fmt: skip
    trust_lattice: Switch = setting(
        False, "Accept a detected lattice although it is uncertain.", group=INPUT
    )
    intrinsics: str | None = setting(
        None, "Camera model of 'clplen calibrate', which removes the distortion of the views.",
        group=INPUT, default_text="none", example="camera.json", metavar="FILE",
    )  # fmt: skip
    step: Positive | None = setting(
        None, "Pixels of a raw image for each view.",
        group=INPUT, default_text="pitch over number of views", example=1.0,
    )  # fmt: skip
    lattice: Literal["square", "hexagonal"] | None = setting(
        None, "Lattice of the lenslets.", group=INPUT, default_text="detected", example="square"
    )
    bayer: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = setting(
        None, "Colour filters of a raw image.", group=INPUT, default_text="none", example="RGGB"
    )
    demosaic: Literal["within", "after", "before"] | None = setting(
        None, "Interpolate colours within lenslets, or after or before slicing into views.",
        group=INPUT, default_text="within", example="within",
    )  # fmt: skip
    devignette: Switch | None = setting(
        None, "Divide a raw image by its white image.",
        group=INPUT, default_text="if there is a white image", example=True,
    )  # fmt: skip
    max_bytes: Size | None = setting(
        None, "Largest allocation that a file may request.",
        group=INPUT, default_text="half of the free memory", example="2 GiB", metavar="SIZE",
    )  # fmt: skip
    force: Switch = setting(False, "Accept a white image whose lattice is uncertain.", group=INPUT)


class PlanesTable(Table):
    """Planes of a stack or of a search for depth."""

    disparities: Planes | None = setting(
        None, _DISPARITIES, group=PLANES, default_text="planes that suit the light field",
        example="-2:2:41", metavar="START:STOP:N",
    )  # fmt: skip
    alphas: Planes | None = setting(
        None, _ALPHAS, group=PLANES, default_text="planes that suit the light field",
        example="0.8:1.2:41", metavar="START:STOP:N",
    )  # fmt: skip

    @model_validator(mode="after")
    def _one_of(self) -> Any:
        if self.alphas is not None and self.disparities is not None:
            raise ValueError("has alphas and disparities: give one of them")
        return self


class StackTable(PlanesTable):
    """``[stack]``: the focal stack; the arguments of `clplen.focal_stack`.

    Attributes
    ----------
    alphas : list of float or None
        Planes F/F', as a list or "START:STOP:N", where the spacing is known.
    disparities : list of float or None
        Planes in pixels a view step, nearer larger, in the same forms; not together with
        ``alphas``. None of both: planes that suit the light field.
    aperture : int, float, str or None
        Views across, a fraction of the diameter (0.5) or "f/66"; None: all views.
    interpolation : {"linear", "nearest", "cubic", "fourier"}
        Between the pixels of the views.
    """

    aperture: Aperture | None = setting(
        None, _APERTURE, default_text="all views", example=9, metavar="N|FRACTION|f/NUMBER"
    )
    interpolation: Interpolation = setting("linear", "Interpolation between pixels of a view.")


class DepthTable(PlanesTable):
    """``[depth]``: the depth map; the arguments of `clplen.depth_map`."""

    cue: Cue | None = setting(
        None, "Depth cue.", default_text="combined, for a microscope energy", example="combined"
    )


class LengthsTable(Table):
    """Lengths of the camera of views, from which disparities are distances in metres."""

    baseline_mm: Positive | None = setting(
        None, "Distance between neighbouring views.", group=LENGTHS
    )
    focal_length_mm: Positive | None = setting(
        None, "Distance from the lens to the sensor.", group=LENGTHS
    )
    pixel_um: Positive | None = setting(None, "Pitch of the pixels.", group=LENGTHS)
    focus_m: Positive | None = setting(
        None, "Distance at which the disparity is 0.", group=LENGTHS, default_text="infinity"
    )

    def build(self) -> dict[str, float] | None:
        """Return the lengths in metres as `clplen.metric_depth` takes them; None without any."""
        if not self.model_fields_set:
            return None
        known = self.in_si()
        names = {"pixel": "pixel_pitch", "focus": "focus_distance"}
        return {names.get(name, name): value for name, value in known.items()}


class AllInFocusTable(Table):
    """``[all_in_focus]``: a picture sharp everywhere; by the depth map where there is one."""

    disparities: Planes | None = setting(
        None, _DISPARITIES, group=PLANES, default_text="planes that suit the light field",
        example="-2:2:33",
    )  # fmt: skip


class ViewsTable(Table):
    """``[views]``: single views, (v, u) from 0, fractions too; without ``at`` the centre view."""

    at: list[tuple[float, float]] | None = setting(
        None, "Views [v, u] from 0; fractions lie between views.",
        default_text="the centre view", example=[[4, 4], [0, 4]],
    )  # fmt: skip
