"""Computations on the device for a page: depth maps, and exact pictures of a light field."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.io.page.light_field_item import depth_item
from clplen.io.page.samples import Content, packed_floats
from clplen.lightfield.depth.depth_maps import CUES, DepthMap
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.rendering import view_weights
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.refocusing.focal_stacks import refocus, upsampled
from clplen.viewer.computations import Answer, Progress

_INTERPOLATIONS = ("linear", "nearest", "cubic", "fourier")
_SHAPES = ("one", "disc", "square", "all")
MAX_PIXELS = 50_000_000  # largest picture sent to a page
_MARGIN = 3  # pixels that interpolation reads beyond a shift


@dataclass
class DeviceComputing:
    """Computations on the light fields of a page, by the number of the item.

    Attributes
    ----------
    device : Device
    light_fields : dict
        LightField or StoredLightField by the number of its item.
    memory : int or None
        Memory limit for a stored light field in bytes.
    depths : dict
        Computed depth maps by the number of the item.
    """

    device: Device
    light_fields: dict[int, LightField | StoredLightField]
    memory: int | None = None
    depths: dict[int, DepthMap] = field(default_factory=dict)

    def __call__(self, request: dict[str, Any], progress: Progress) -> Answer:
        """Compute the requested depth map or picture."""
        number = _integer(request.get("item"), 0, 10**6, "item")
        lf = self.light_fields.get(number)
        if lf is None:
            raise ValueError("This item is not a light field: select another item.")
        if request.get("kind") == "depth":
            return self._depth(number, lf, request, progress)
        if request.get("kind") == "picture":
            return self._picture(number, lf, request, progress)
        raise ValueError("The kind of a request must be 'depth' or 'picture'.")

    def _depth(
        self,
        number: int,
        lf: LightField | StoredLightField,
        request: dict[str, Any],
        progress: Progress,
    ) -> Answer:
        cue = request.get("cue")
        if cue is not None and cue not in CUES:
            raise ValueError(f"cue must be one of {', '.join(CUES)}, got {cue!r}.")
        downscale = _integer(request.get("downscale", 1), 1, 10**4, "downscale")
        progress(0.0, "Depth")
        depth = depth_map(
            lf,
            cue=cue,
            memory=self.memory,
            device=self.device,
            progress=lambda done, total: progress(done / total, "Depth"),
        )
        progress(1.0, "Depth")
        self.depths[number] = depth
        content = Content()
        item = depth_item(depth, content, downscale)
        return item, content.encoded()

    def _picture(
        self,
        number: int,
        lf: LightField | StoredLightField,
        request: dict[str, Any],
        progress: Progress,
    ) -> Answer:
        interpolation = request.get("interpolation", "linear")
        if interpolation not in _INTERPOLATIONS:
            raise ValueError(f"interpolation must be one of {', '.join(_INTERPOLATIONS)}.")
        upsample = _integer(request.get("upsample", 1), 1, 16, "upsample")
        state = _state(request.get("state"), lf.shape)
        region = _region(request.get("region"), lf.shape)
        pixels = np.prod([stop - start for start, stop in region]) * upsample**2
        if pixels > MAX_PIXELS:
            raise ValueError(
                f"The picture must have at most {MAX_PIXELS:,} pixels, got {int(pixels):,}: zoom "
                "in, or reduce the upsampling."
            )
        progress(0.0, "Picture")
        disparity: Any = state["d"]
        if state["sharp"]:
            if number not in self.depths:
                self._depth(number, lf, {}, progress)
            disparity = self.depths[number].disparity
        part, inside, disparity = self._part(lf, region, disparity, interpolation)
        picture = _render(part, state, disparity, interpolation, upsample)
        rows, columns = (slice(s.start * upsample, s.stop * upsample) for s in inside)
        values = np.ascontiguousarray(picture[rows, columns])
        channels = values.shape[2] if values.ndim == 3 else 1
        result = {"shape": [*values.shape[:2], channels], "region": [e for s in region for e in s]}
        return result, [packed_floats(values.reshape(values.shape[0], -1))]

    def _part(
        self,
        lf: LightField | StoredLightField,
        region: tuple[tuple[int, int], tuple[int, int]],
        disparity: Any,
        interpolation: str,
    ) -> tuple[LightField, tuple[slice, slice], Any]:
        """Return the part of a light field around a region, the region in it, and its disparity."""
        if isinstance(lf, LightField):
            return lf, (slice(*region[0]), slice(*region[1])), disparity
        if interpolation == "fourier":
            raise ValueError("Fourier interpolation needs complete views: leave out --memory.")
        reach = np.abs(unit_steps(lf)).reshape(-1, 2).max(axis=0) * np.abs(disparity).max()
        blocks: list[slice] = []
        inside: list[slice] = []
        for (start, stop), size, far in zip(region, lf.shape[2:4], reach, strict=True):
            margin = int(np.ceil(2 * far)) + _MARGIN
            first, last = max(start - margin, 0), min(stop + margin, size)
            blocks.append(slice(first, last))
            inside.append(slice(start - first, stop - first))
        samples = lf.read((slice(None), slice(None), blocks[0], blocks[1]))
        if np.ndim(disparity):
            disparity = disparity[blocks[0], blocks[1]]
        return lf.part(samples, self.device), (inside[0], inside[1]), disparity


def _render(
    lf: LightField, state: dict[str, Any], disparity: Any, interpolation: str, upsample: int
) -> np.ndarray[Any, Any]:
    """Render the picture of a state of the viewer."""
    at = (state["v"], state["u"])
    if state["shape"] == "one":
        kind = "linear" if interpolation == "fourier" else interpolation
        return lf.view(*at, disparity=disparity, interpolation=kind).to_numpy()
    centred = all(x == (n - 1) / 2 for x, n in zip(at, lf.shape, strict=False))
    aperture = {"disc": state["diameter"], "square": state["across"], "all": None}[state["shape"]]
    viewpoint = None if centred or aperture is None else at
    if upsample > 1:
        if np.ndim(disparity):
            raise ValueError("All in focus needs an upsampling of 1.")
        weights = view_weights(lf, aperture, viewpoint)
        return lf.device.download(upsampled(lf, float(disparity), upsample, weights))
    if interpolation == "fourier":
        if aperture is not None or np.ndim(disparity):
            raise ValueError("Fourier interpolation needs all views and a single plane.")
        return refocus(lf, disparity=disparity, interpolation="fourier").to_numpy()
    return lf.flatten(
        disparity=disparity, interpolation=interpolation, aperture=aperture, viewpoint=viewpoint
    ).to_numpy()


def _integer(value: Any, low: int, high: int, name: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number from {low} to {high}, got {value!r}.")
    return value


def _number(value: Any, low: float, high: float, name: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} must be a number from {low:g} to {high:g}, got {value!r}.")
    return float(value)


def _state(request: Any, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return the checked state of a page."""
    state = request if isinstance(request, dict) else {}
    if state.get("shape") not in _SHAPES:
        raise ValueError(f"The aperture must be one of {', '.join(_SHAPES)}.")
    return {
        "shape": state["shape"],
        "v": _number(state.get("v"), 0, shape[0] - 1, "v"),
        "u": _number(state.get("u"), 0, shape[1] - 1, "u"),
        "d": _number(state.get("d"), -1e4, 1e4, "The disparity"),
        "diameter": _number(state.get("diameter", 1), 1e-3, 1, "The diameter"),
        "across": _integer(state.get("across", 1), 1, max(shape[:2]), "across"),
        "sharp": state.get("sharp") is True,
    }


def _region(request: Any, shape: tuple[int, ...]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return rows and columns of a region; all for None."""
    if request is None:
        return (0, shape[2]), (0, shape[3])
    if not isinstance(request, list) or len(request) != 4:
        raise ValueError("A region must be a list y0, y1, x0, x1.")
    ends = []
    for (start, stop), size in zip((request[:2], request[2:]), shape[2:4], strict=True):
        first = _integer(start, 0, size - 1, "The start of a region")
        ends.append((first, _integer(stop, first + 1, size, "The end of a region")))
    return ends[0], ends[1]
