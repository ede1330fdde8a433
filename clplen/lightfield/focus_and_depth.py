"""Focal stacks, depth maps and all-in-focus pictures of light fields of any size.

A light field on a device is taken as it is. One that is stored is read whole where memory suffices,
and else streamed tile by tile; the result is of the same type and has the same values.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from clplen.compute.arrays import Image
from clplen.compute.device import DeviceLike, as_device
from clplen.lightfield.depth.all_in_focus import all_in_focus_in_memory
from clplen.lightfield.depth.depth_maps import DepthMap, depth_map_in_memory
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.refocusing.focal_stacks import FocalStack, focal_stack_in_memory
from clplen.lightfield.streaming.streamed_results import (
    assemble_stack,
    stream_all_in_focus,
    stream_depth,
)


def focal_stack(
    lf: LightField | StoredLightField | ArrayLike,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    aperture: Any = None,
    interpolation: str = "linear",
    memory: int | None = None,
    device: DeviceLike | None = None,
) -> FocalStack:
    """Make pictures focused on many planes, in one pass over the light field.

    Every plane is what `refocus` returns for it (without rescaling). A stored light field is read
    whole where memory suffices and else tile by tile, with the same result.

    Parameters
    ----------
    lf : LightField, StoredLightField or array_like
        Shape (v, u, y, x[, c]).
    alphas, disparities : array_like, optional
        Planes, shape (n,), in any order; exactly one of the two: F/F', which needs the spacing of
        the light field, or pixels a view step.
    aperture : int, float, str or array_like, optional
        As in `LightField.render`.
    interpolation : {"linear", "nearest", "cubic", "fourier"}
        As in `refocus`; "fourier" needs whole views.
    memory : int, optional
        Bytes for what a stored light field needs on the host and the device together, the result
        included; default half of what is free on the host, or of the device's memory if that is
        less. What does not fit is made in tiles.
    device : Device or str, optional
        Where an array or a stored light field goes; default ``Device.open()``. Other light fields
        bring their own.

    Returns
    -------
    FocalStack
        Pictures, float32, shape (n, y, x[, c]). It keeps the weights of its views, by which depth
        makes planes equally blurred, for linear interpolation only.

    Raises
    ------
    ValueError
        If both or neither of alphas and disparities are given, or they are no finite numbers in
        one dimension, no two views overlap on a plane, the aperture does not fit, the
        interpolation is unknown, or a stored light field does not fit into the memory: its stack
        itself (take `stream_stack`, or ``clplen stack``), its smallest tile, or whole views for
        "fourier".
    DeviceError
        If the stack and the light field together are larger than the device's memory.
    OSError, FormatError
        As in `stream_stack`.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1, 64))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> stack = clplen.focal_stack(lf, disparities=[-0.5, 0, 0.5, 1])
    >>> stack.shape
    (4, 32, 32)
    >>> int(stack.to_numpy().std(axis=(1, 2)).argmax())  # the plane in focus
    2
    """
    planes: dict[str, Any] = {"alphas": alphas, "disparities": disparities}
    options: dict[str, Any] = {"aperture": aperture, "interpolation": interpolation}
    if isinstance(lf, StoredLightField):
        return assemble_stack(lf, **planes, **options, memory=memory, device=device)
    return focal_stack_in_memory(lf, **planes, **options, device=device)


def depth_map(
    source: LightField | StoredLightField | FocalStack | ArrayLike,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    cue: str | None = None,
    memory: int | None = None,
    device: DeviceLike | None = None,
) -> DepthMap:
    """Find the disparity at every pixel of the centre view, finer than the planes that are tried.

    Parameters
    ----------
    source : LightField, StoredLightField, FocalStack or array_like
        A stack brings its own planes, in any order, and allows only "energy"; one without
        `weights` of its views is taken as it is. A stored light field is read whole where memory
        suffices and else tile by tile, with the same result.
    alphas, disparities : array_like, optional
        Planes to try, at least three different ones, not both. For a light field without either
        those of `suitable_planes`: 33 alphas from .65 to 1.35 where the spacing is known, the depth
        range of a microscope, else 33 disparities from -2 to 2.
    cue : {"energy", "correspondence", "structure-tensor", "combined"}, optional
        See Notes. Default "energy" for a stack, and for the light field of a microscope: what
        fluoresces is transparent, where the other cues look for surfaces and put single points on
        disparity 0; "combined" for other light fields.
    memory : int, optional
        Bytes for what a stored light field needs on the host and the device together, the result
        included; default half of what is free on the host, or of the device's memory if that is
        less. What does not fit is made in tiles.
    device : Device or str, optional
        Where an array or a stored light field goes; default ``Device.open()``. Other light fields
        bring their own.

    Returns
    -------
    DepthMap
        Maps of disparity, alpha, z and confidence, float32, shape (y, x).

    Raises
    ------
    ValueError
        If the cue is unknown or needs the views that a stack does not have, alphas and disparities
        are both given or given with a stack, there are fewer than three planes or no two
        views overlap on one; or the smallest tile of a stored light field does not fit into the
        memory.
    DeviceError
        If what is needed is larger than the device's memory.
    OSError, FormatError
        As in `stream_stack`.

    Warns
    -----
    SamplingWarning
        From NA/n = .7 of a microscope on, where ``z`` is too far from the native plane by the
        factor that it names (`clplen.lightfield.depth.best_focus`).

    Notes
    -----
    The cues are:

    - "energy": the sharpest plane: highest local energy of detail of the refocused picture
      (`clplen.lightfield.depth.energy_cue`). A cue of defocus: strong in noise, weak beside
      occlusions.
    - "correspondence": the plane on which the views agree: least variance over the views in a box
      of 9 pixels (`clplen.lightfield.depth.correspondence_cue`). Sharp at edges, misled by
      highlights and noise.
    - "structure-tensor": the orientation of the epipolar-plane images, sheared in steps, most
      coherent of both directions (`clplen.lightfield.depth.structure_tensor_cue`). Of the planes
      only the range counts.
    - "combined": matching past occlusions with adaptive support, by the samples or, where the
      brightness of the views differs, by their detail, refined by least squares
      (`clplen.lightfield.depth.combined_cue`): the most exact, and the slowest. Bright points on
      black, as of beads and stars, get the depth of their sharpest plane, and the black none
      (confidence 0).

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1, 64))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> depth = clplen.depth_map(lf, disparities=np.linspace(-1, 1, 9))
    >>> depth.disparity.shape, f"{np.median(depth.disparity):.2f} pixels a view step"
    ((32, 32), '0.50 pixels a view step')
    """
    options: dict[str, Any] = {"alphas": alphas, "disparities": disparities, "cue": cue}
    if isinstance(source, StoredLightField):
        return stream_depth(source, **options, memory=memory, device=device)
    return depth_map_in_memory(source, **options, device=device)


def all_in_focus(
    source: LightField | StoredLightField | FocalStack | ArrayLike,
    *,
    depth: DepthMap | ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    memory: int | None = None,
    device: DeviceLike | None = None,
) -> Image:
    """Make one picture that is sharp at every depth, in the values of the light field (linear).

    With a depth map, every pixel is taken at its own disparity: of a light field by averaging its
    views there (`refocus` on a surface), of a stack linearly between its two nearest planes (held
    beyond the ends).

    Without one, the planes of a stack are blended with weights (E_d / max_d E)^32, where E_d is
    the local energy of `depth_map`, smooth over a window of 4 pixels, so that no seams appear;
    where nothing has any texture all planes count alike.

    Parameters
    ----------
    source : LightField, StoredLightField, FocalStack or array_like
        A stored light field is read whole where memory suffices and else tile by tile.
    depth : DepthMap or array_like, optional
        Or disparities, shape (y, x), in pixels a view step, finite.
    disparities : array_like, optional
        Planes to blend, for a light field without depth; default those of `suitable_planes`, as
        for `depth_map`.
    memory : int, optional
        Bytes for what a stored light field needs on the host and the device together, the result
        included; default half of what is free on the host, or of the device's memory if that is
        less. What does not fit is made in tiles.
    device : Device or str, optional
        Where an array or a stored light field goes; default ``Device.open()``. Other light fields
        bring their own.

    Returns
    -------
    Image
        Of the centre view, float32, shape (y, x[, c]).

    Raises
    ------
    ValueError
        If a disparity is not finite, no two views overlap on a plane or anywhere on the surface,
        or planes are given that are not used; or the smallest tile of a stored light field does
        not fit into the memory.
    ShapeError
        If the depth map is not of the size of the views.
    DeviceError
        If the stack is larger than the device's memory.
    OSError, FormatError
        As in `stream_stack`.

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
    options: dict[str, Any] = {"depth": depth, "disparities": disparities}
    if isinstance(source, StoredLightField):
        device = as_device(device)
        picture = stream_all_in_focus(source, **options, memory=memory, device=device)
        return Image(device.upload(picture), device)
    return all_in_focus_in_memory(source, **options, device=device)
