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
    __name__,
    "``[inputs.layout]``: arguments of `clplen.read_lightfield`.",
    ReadingSettings,
)
DepthTable: Any = table_of(
    "DepthTable",
    __name__,
    "``[depth]``: a depth map; arguments of `clplen.depth_map`.",
    DepthSettings,
)
AllInFocusTable: Any = table_of(
    "AllInFocusTable",
    __name__,
    "``[all_in_focus]``: an all-in-focus picture; uses the map of ``[depth]`` if present.",
    AllInFocusSettings,
)
ViewsTable: Any = table_of(
    "ViewsTable",
    __name__,
    "``[views]``: single views (v, u), also fractional; the centre view by default.",
    ViewSettings,
)
StackTable: Any = table_of(
    "StackTable",
    __name__,
    "``[stack]``: a focal stack; arguments of `clplen.focal_stack`.",
    StackSettings,
)
