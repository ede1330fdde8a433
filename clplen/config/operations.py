"""Tables of job files from the settings of operations on light fields."""

from __future__ import annotations

from typing import Any

from clplen.config.setting_tables import table_of
from clplen.settings.light_fields import (
    AllInFocusSettings,
    DepthSettings,
    StackSettings,
    ViewSettings,
)
from clplen.settings.reading import ReadingSettings

LayoutTable: Any = table_of(
    "LayoutTable",
    "``[inputs.layout]``: the arguments of `clplen.read_lightfield`.",
    ReadingSettings,
)
DepthTable: Any = table_of(
    "DepthTable", "``[depth]``: the depth map; the arguments of `clplen.depth_map`.", DepthSettings
)
AllInFocusTable: Any = table_of(
    "AllInFocusTable",
    "``[all_in_focus]``: a picture sharp everywhere; by the depth map where there is one.",
    AllInFocusSettings,
)
ViewsTable: Any = table_of(
    "ViewsTable",
    "``[views]``: single views, (v, u) from 0, fractions too; without ``at`` the centre view.",
    ViewSettings,
)
_Stack: Any = table_of("_Stack", "", StackSettings)


class StackTable(_Stack):
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
