"""Raw images of Lytro cameras as light fields."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.lightfields.layout import Layout
from clplen.io.lightfields.lenslet_frames import decode_frame
from clplen.io.raw.lytro_container import read_container
from clplen.lightfield.lightfield import LightField


def read(
    path: PathLike, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read the raw image of a Lytro camera and decode it.

    Parameters
    ----------
    path : path-like
        A container; or a raw image, or the JSON that describes it, which lie side by side.
    device : Device
    layout : Layout
        With the user's white image or lenslet grid.
    progress : bool
        Whether to show a bar on standard error.

    Returns
    -------
    LightField, str
        The light field, and what was taken for what, in one sentence.

    Raises
    ------
    FormatError
        If the file is damaged or holds no raw image, or neither a white image nor a grid is given.
    """
    path = Path(path)
    frame, bayer = read_container(path, max_bytes=layout.max_bytes)
    if layout.white is None and layout.grid is None:
        raise FormatError(
            f"{path} holds a raw image of {frame.shape[1]} x {frame.shape[0]} pixels, and its "
            "lenslets cannot be found on the scene itself: give white=, the white image of the "
            "same camera at the same zoom and focus, or grid=, a lenslet grid saved before."
        )
    layout = replace(layout, bayer=layout.bayer or bayer)
    return decode_frame(frame, path, device=device, layout=layout, progress=progress)
