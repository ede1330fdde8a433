"""What a caller writes, under mypy's strict flags (pyproject.toml): arrays and results alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import clplen


def light_fields(folder: Path, views: NDArray[np.float32], lf: clplen.LightField) -> None:
    """A light field is a `LightField` or an array."""
    for source in (views, lf, views.tolist()):
        clplen.write_lightfield(folder / "views.h5", source)
        clplen.io.write_views(folder / "views", source)
        clplen.io.write_mosaic(folder / "mosaic.png", source)
        clplen.focal_stack(source, disparities=[0, 1])
        clplen.refocus(source, disparity=0.5)
        clplen.estimate_alpha(source, method="energy")
        clplen.lightfield.check_light_field(source)
        clplen.lightfield.fourier_stack(source, disparities=[0])
        clplen.lightfield.hyperfan(source, -0.5, 0.5)
        clplen.lightfield.phase_space(source, y=0, v=0)
        clplen.lightfield.shift_views(source, np.zeros((3, 3, 2)))
        clplen.lightfield.suitable_planes(source)
        clplen.lightfield.view_between(source, 1, 1.5, 0.0)
        clplen.plot.views(source)
        clplen.plot.epi(source)
    clplen.write_lightfield(folder / "list.h5", [[[[0.0, 1.0]], [[1.0, 2.0]]]])


def pictures(folder: Path, values: NDArray[np.uint8], image: clplen.Image) -> None:
    """A picture is an `Image` or an array."""
    clplen.plot.picture(image)
    clplen.plot.picture(values)
    clplen.plot.refocused([image, values], ["result", "array"])
    clplen.io.write_image(folder / "picture.tif", image)
    clplen.io.write_image(folder / "picture.tif", values)
    clplen.io.write_picture(folder / "picture.png", values)
    clplen.io.anaglyph(values, values)


def depth_maps(folder: Path, disparity: NDArray[np.float64], lf: clplen.LightField) -> None:
    """A depth map is a `DepthMap` or an array of disparities."""
    depth = clplen.depth_map(lf)
    clplen.plot.depth(depth)
    clplen.plot.depth(disparity)
    clplen.io.write_depth(folder / "depth.pfm", depth)
    clplen.io.write_depth(folder / "depth.pfm", disparity)
    clplen.io.write_html(folder / "page.html", lf, depth=disparity)
    clplen.all_in_focus(lf, depth=disparity)
    clplen.io.points_of(disparity)
