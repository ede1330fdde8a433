"""Depth maps and all-in-focus pictures of light fields of any size.

A light field is a source of tiles; on a device it is a single tile. A stored light field is loaded
if memory suffices. Otherwise it is read tile by tile, with a halo for the shifts of the planes and
the windows of a cue; the result is bitwise equal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.compute.arrays import Image
from clplen.compute.device import Device, DeviceLike
from clplen.lightfield.depth.all_in_focus import (
    between_planes,
    blend_memory,
    blended,
    check_planes,
    disparity_of,
    surface_memory,
)
from clplen.lightfield.depth.best_focus import default_disparities
from clplen.lightfield.depth.cue import Cue
from clplen.lightfield.depth.depth_maps import (
    DepthMap,
    cue_named,
    default_cue,
    distinct_planes,
    with_depth,
)
from clplen.lightfield.depth.energy_cue import energy_disparity
from clplen.lightfield.model.alpha_law import require_overlap
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.rendering import through
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.refocusing.focal_stacks import (
    FocalStack,
    on_surface,
    stack_on_planes,
    stack_planes,
)
from clplen.lightfield.streaming.tile_plan import StreamPlan, Tile, bands, plan_tiles
from clplen.lightfield.streaming.tile_reading import (
    Progress,
    Source,
    as_source,
    fast_source,
    read_tiles,
)
from clplen.progress import notebook_bar


@notebook_bar("estimating depth")
def depth_map(
    source: LightField | StoredLightField | FocalStack | ArrayLike,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    aperture: Any = None,
    cue: str | None = None,
    memory: int | None = None,
    device: DeviceLike | None = None,
    progress: Progress | None = None,
) -> DepthMap:
    """Estimate the disparity at every pixel of the centre view, with subplane accuracy.

    Parameters
    ----------
    source : LightField, StoredLightField, FocalStack or array_like
        Light field or focal stack. A stack has fixed planes, in any order, and allows only
        "energy"; without `weights` of its views it is not corrected for interpolation blur.
    alphas, disparities : array_like, optional
        Planes to search, at least three different ones, as one of the two. Default for a light
        field: `suitable_planes`, i.e. 33 alphas from 0.65 to 1.35 if the spacing is known, the
        depth range of a microscope, else 33 disparities from -2 to 2.
    aperture : int, float, str or array_like, optional
        Part of the main lens whose views are used, as in `focal_stack`; not with a stack. Default
        all views.
    cue : {"energy", "correspondence", "structure-tensor", "combined"}, optional
        Depth cue, see Notes. Default "energy" for a stack and for the light field of a microscope:
        fluorescence is transparent, while other cues search surfaces and place single points at
        disparity 0. Default "combined" for other light fields.
    memory, device : int, Device or str, optional
        Memory and device, see `focal_stack`.
    progress : callable, optional
        Function called with (tiles done, number of tiles).

    Returns
    -------
    DepthMap
        Maps of disparity, alpha, z and confidence, float32, shape (y, x).

    Raises
    ------
    ValueError
        If the cue is unknown or needs views, which a stack does not have; alphas, disparities or
        aperture are inconsistent or combined with a stack; there are fewer than three planes, or no
        views overlap on a plane; or the smallest tile of a stored light field exceeds the memory.
    DeviceError
        If the device's memory does not suffice.
    OSError, FormatError
        See `stack_tiles`.

    Warns
    -----
    SamplingWarning
        From NA/n = 0.7 of a microscope on, where ``z`` is too far from the native plane by the
        factor in the message (`clplen.lightfield.depth.best_focus`).

    Notes
    -----
    The cues are:

    - "energy": the sharpest plane, by the local energy of detail of the refocused picture
      (`clplen.lightfield.depth.energy_cue`). A defocus cue: robust in noise, weak beside
      occlusions.
    - "correspondence": the plane of least variance over the views in a box of 9 pixels
      (`clplen.lightfield.depth.correspondence_cue`). Sharp at edges, misled by highlights and
      noise.
    - "structure-tensor": the orientation of epipolar-plane images, sheared in steps, in the more
      coherent of both directions (`clplen.lightfield.depth.structure_tensor_cue`). Only the range
      of the planes matters.
    - "combined": occlusion-aware matching with adaptive support, on samples or, where the
      brightness of the views differs, on detail, refined by least squares
      (`clplen.lightfield.depth.combined_cue`): the most accurate and slowest. Bright points on
      black, such as beads and stars, get the depth of their sharpest plane; the black gets
      confidence 0.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1, 64))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> depth = clplen.depth_map(lf, disparities=np.linspace(-1, 1, 9))
    >>> depth.disparity.shape, f"{np.median(depth.disparity):.2f} pixels a view step"
    ((32, 32), '0.50 pixels a view step')
    """
    if isinstance(source, FocalStack):
        if aperture is not None:
            raise ValueError(
                "A focal stack has a fixed aperture; aperture can only be combined with a light "
                "field."
            )
        cue_named(cue or "energy")
        planes = distinct_planes(source, alphas, disparities)
        if cue not in (None, "energy"):
            raise ValueError(
                f"cue={cue!r} compares views, which a focal stack does not have; pass the light "
                "field, or cue='energy'."
            )
        return with_depth(source, *energy_disparity(source, planes))
    lf, device = as_source(source, device)
    lf = through(lf, aperture)
    cue_steps = cue_named(default_cue(lf) if cue is None else cue)
    planes = distinct_planes(lf, alphas, disparities)
    plan = plan_tiles(lf, [cue_steps.memory(lf, planes)], memory=memory, device=device)
    if plan.in_core and isinstance(lf, StoredLightField):
        lf = lf.load(device)
    size = lf.shape[2:4]
    maps = DepthMap(*(np.empty(size, np.float32) for _ in range(4)))
    lost = np.zeros(size if cue_steps.survey else (0, 0), np.bool_)
    with fast_source(lf, plan) as fast:
        survey_args = (_surveyed(fast, plan, cue_steps, device),) if cue_steps.survey else ()
        for tile, part in read_tiles(fast, plan.tiles, device, progress):
            inside: Any = {"inside": tile.inside} if cue_steps.survey else {}
            disparity, confidence, *masks = cue_steps.disparity(
                part, planes, *survey_args, **inside
            )
            del part  # before the next tile is sent to the device
            for mask in masks:
                lost[tile.rows, tile.columns] = mask[tile.inside]
            depth = with_depth(lf, disparity[tile.inside], confidence[tile.inside])
            for attribute, values in vars(depth).items():
                getattr(maps, attribute)[tile.rows, tile.columns] = values
    if cue_steps.merge is not None:
        maps.confidence[...] = cue_steps.merge(maps.confidence, lost)
    return maps


def _surveyed(source: Source, plan: StreamPlan, cue: Cue, device: Device) -> Any:
    """Survey the whole light field for a cue in bands of rows."""
    assert cue.survey is not None
    survey = cue.survey(source)
    for tile, lf in read_tiles(source, bands(source.shape[2:4], plan.band_rows), device, None):
        survey.add(tile.rows, lf)
        del lf  # before the next tile is sent to the device
    return survey.finish()


@notebook_bar("focusing")
def all_in_focus(
    source: LightField | StoredLightField | FocalStack | ArrayLike,
    *,
    depth: DepthMap | ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    memory: int | None = None,
    device: DeviceLike | None = None,
    progress: Progress | None = None,
) -> Image:
    """Compute a picture that is sharp at every depth, in (linear) values of the light field.

    With a depth map, every pixel is refocused at its disparity: a light field by averaging its
    views there (`refocus` on a surface), a stack by linear interpolation between its two nearest
    planes (constant beyond the ends).

    Without a depth map, the planes of a stack are blended with weights (E_d / max_d E)^32. E_d is
    the local energy of `depth_map`, smooth over a window of 4 pixels, which avoids seams; planes
    without any texture count equally.

    Parameters
    ----------
    source : LightField, StoredLightField, FocalStack or array_like
        Views, or pictures of them on planes.
    depth : DepthMap or array_like, optional
        Depth map or disparities of shape (y, x), in pixels a view step, finite.
    disparities : array_like, optional
        Planes to blend, for a light field without depth; default `suitable_planes`, as in
        `depth_map`.
    memory, device : int, Device or str, optional
        Memory and device, see `focal_stack`.
    progress : callable, optional
        Function called with (tiles done, number of tiles).

    Returns
    -------
    Image
        All-in-focus centre view, float32, shape (y, x[, c]).

    Raises
    ------
    ValueError
        If a disparity is not finite, no views overlap on a plane or on the surface, planes are
        superfluous, or the smallest tile of a stored light field exceeds the memory.
    ShapeError
        If the depth map and the views differ in size.
    DeviceError
        If the stack exceeds the device's memory.
    OSError, FormatError
        See `stack_tiles`.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1, 64))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> sharp = clplen.all_in_focus(lf, depth=truth.disparity)
    >>> sharp
    <Image (32, 32) float32, ...>
    >>> bool(np.abs(np.asarray(sharp) - lf.view(2, 2)).max() < 0.1)
    True
    """
    if isinstance(source, FocalStack):
        check_planes(source, disparities)
        if depth is None:
            return Image(blended(source), source.device)
        surface = disparity_of(depth, source.shape[1:3])
        return Image(between_planes(source, surface), source.device)
    source, device = as_source(source, device)
    check_planes(depth, disparities)
    if depth is not None:
        surface = disparity_of(depth, source.shape[2:4])
        require_overlap(source, source.weights, surface)
        estimate = surface_memory(source, surface)
    else:
        planes_to_blend = default_disparities(source) if disparities is None else disparities
        planes, ratios = stack_planes(
            source, source.weights, alphas=None, disparities=planes_to_blend
        )
        estimate = blend_memory(source, planes)
    plan = plan_tiles(source, [estimate], memory=memory, device=device)

    def focused(tile: Tile, lf: LightField) -> cla.Array:
        if depth is None:
            return blended(stack_on_planes(lf, planes, ratios, lf.weights))
        return on_surface(lf, surface[tile.outer_rows, tile.outer_columns])

    out = np.empty((0,) if plan.in_core else source.shape[2:], np.float32)
    with fast_source(source, plan) as fast:
        for tile, lf in read_tiles(fast, plan.tiles, device, progress):
            picture = focused(tile, lf)
            del lf  # before the next tile is sent to the device
            if not plan.in_core:
                out[tile.rows, tile.columns] = device.download(picture)[tile.inside]
    return Image(picture if plan.in_core else device.upload(out), device)
