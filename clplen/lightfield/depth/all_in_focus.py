"""All-in-focus pictures: every pixel from the plane on which it is sharp."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.image import Image
from clplen.errors import ShapeError
from clplen.lightfield.arrays.ray_samples import checked_disparity
from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps
from clplen.lightfield.depth.local_energy import LocalEnergy
from clplen.lightfield.depth.plane_choice import default_disparities
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.refocus.focal_stack import FocalStack, focal_stack, refocus

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clplen.lightfield.depth.depth_map import DepthMap
    from clplen.lightfield.model.light_field import LightField

_HIGH_PASS, _WINDOW = 1.5, 4.0  # pixels, as for depth
_AT_ONCE = 8  # planes whose energy is held before it is smoothed
_DOUBLINGS = 5  # energy to the power of 32: planes next to the sharpest share, others do not


def all_in_focus(
    source: LightField | FocalStack,
    *,
    depth: DepthMap | ArrayLike | None = None,
    disparities: ArrayLike | None = None,
) -> Image:
    """One picture that is sharp at every depth, in the values of the light field (linear).

    With a depth map, every pixel is taken at its own disparity: of a light field by averaging its
    views there (`refocus` on a surface), of a stack linearly between its two nearest planes (held
    beyond the ends).

    Without one, the planes of a stack are blended with weights (E_d / max_d E)^32, where E_d is
    the local energy of `depth_map`, smooth over a window of 4 pixels, so that no seams appear;
    where nothing has any texture all planes count alike.

    Parameters
    ----------
    source : LightField or FocalStack
    depth : DepthMap or array_like, optional
        Or disparities, shape (y, x), in pixels a view step, finite.
    disparities : array_like, optional
        Planes to blend, for a light field without depth; default 33 from -2 to 2, of a microscope
        over its depth range (`suitable_planes`).

    Returns
    -------
    Image
        float32, shape (y, x[, c]).

    Raises
    ------
    ValueError
        If a disparity is not finite, or planes are given that are not used.
    ShapeError
        If the depth map is not of the size of the views.
    DeviceError
        If the stack is larger than the device's memory.
    """
    if not isinstance(source, FocalStack):
        source = as_lightfield(source, "stream_all_in_focus")
    check_planes(depth if not isinstance(source, FocalStack) else source, disparities)
    if isinstance(source, FocalStack):
        if depth is None:
            return Image(_blended(source), source.device)
        return Image(_between(source, disparity_of(depth, source.shape[1:3])), source.device)
    if depth is not None:
        return refocus(source, disparity=disparity_of(depth, source.shape[2:4]))
    planes = default_disparities(source) if disparities is None else disparities
    return Image(_blended(focal_stack(source, disparities=planes)), source.device)


def check_planes(known: Any, disparities: Any) -> None:
    """Refuse planes where a depth map or a stack is given already.

    Raises
    ------
    ValueError
    """
    if disparities is not None and known is not None:
        raise ValueError(
            "all_in_focus takes disparities= only for a light field without a depth map: leave "
            "them out."
        )


def disparity_of(depth: Any, size: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """Disparity of every pixel, of a depth map or by itself; float64.

    Raises
    ------
    ShapeError, ValueError
        If it is not one of every pixel, or not finite.
    """
    d = checked_disparity(getattr(depth, "disparity", depth), (size[0], size[1]))
    if d.ndim == 0:
        raise ShapeError(
            f"A depth map has a disparity for every pixel, shape {tuple(size)}; for one plane use "
            "refocus."
        )
    return d


def _between(stack: FocalStack, disparity: np.ndarray[Any, Any]) -> cla.Array:
    """Each pixel between the planes below and above its disparity."""
    order = np.argsort(stack.disparities, kind="stable")
    rising = stack.disparities[order]
    data = stack.data
    if not np.array_equal(order, np.arange(order.size)):
        data = stack.device.empty(stack.shape, np.float32)
        for index, plane in enumerate(order):
            picture = stack.data[int(plane)]
            stack.device.copy_into(data, picture, index * picture.nbytes)
    place = np.interp(disparity, rising, np.arange(rising.size)).astype(np.float32)
    return _launch("between", stack, data, stack.device.upload(place))


def _blended(stack: FocalStack) -> cla.Array:
    """The planes by their local energy."""
    count, ny, nx = stack.shape[:3]
    device = stack.device
    maps = 4 * ny * nx * (count + _AT_ONCE)
    device.require_memory(stack.data.nbytes + maps, "This stack with its sharpness")
    energies = device.empty((count, ny, nx), np.float32)
    some = device.empty((min(_AT_ONCE, count), ny, nx), np.float32)
    gather = Smoother(gaussian_taps(_WINDOW), device=device)
    measure = LocalEnergy(_HIGH_PASS, stack.shape[1:], device=device)
    for start in range(0, count, _AT_ONCE):
        planes = min(_AT_ONCE, count - start)
        measure(some, stack, start=start, count=planes)
        gather(energies, some, start=start, count=planes)
    return _launch("blend", stack, stack.data, energies, np.int32(_DOUBLINGS))


def _launch(name: str, stack: FocalStack, data: cla.Array, *more: Any) -> cla.Array:
    count, ny, nx, channels = (*stack.shape, 1)[:4]
    out = stack.device.empty(stack.shape[1:], np.float32)
    stack.device.launch_rows(
        stack.device.kernel("allinfocus.cl", name),
        (ny, nx * channels),
        out,
        data,
        *more,
        *(np.int32(n) for n in (count, ny, nx, channels)),
    )
    return out
