"""``clplen depth``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared import metric, options
from clplen.cli.shared.console import (
    check_outputs,
    check_planes,
    check_suffix,
    disparities_of,
    fraction_at_ends,
    note_end,
    note_nearly_black,
    open_stored,
    planes_of,
    read,
    tile_progress,
)
from clplen.cli.shared.focused import (
    SUFFIXES,
    check_raw_picture,
    depth_options,
    find_depth,
    is_focused_raw,
    refuse_options,
)
from clplen.cli.shared.focused import read as open_raw
from clplen.cli.shared.setting_options import setting_options
from clplen.settings.light_fields import DepthSettings

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.lightfield.depth.depth_maps import DepthMap
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.stored_light_field import StoredLightField

Values = np.ndarray[Any, Any]

_MAPS = (".pfm", ".tif", ".tiff", ".npy")
MIN_CONFIDENCE = 1e-3  # a map whose largest confidence is lower shows rounding errors only
MAX_AT_ENDS = 0.01  # fraction of pixels at the first or last plane above which a hint is printed
RELIABLE_ABOVE = 0.5  # confidence above which a pixel counts as reliable


@click.command(cls=options.Command)
@options.source
@options.output(
    "OUT.pfm|OUT.tif|OUT.npy",
    "Output file of the disparities; a picture .png of equal name is written beside it.",
)
@setting_options(DepthSettings, "aperture", "cue")
@options.file("--confidence", help="Output file of the confidence, 0 to 1: .pfm, .tif or .npy.")
@depth_options
@options.plane_range
@metric.lengths
@options.memory
@options.layout
@options.device
def depth(
    source: Path,
    output: Path,
    cue: str | None,
    confidence: Path | None,
    aperture: Any,
    ms: Any,
    focused: bool,
    image: Path | None,
    disparities: Any,
    alphas: Any,
    memory: int | None,
    selector: str | None,
    **arguments: Any,
) -> None:
    """Estimate the disparity of every pixel.

    \b
    Example:
      clplen depth flower -o flower.pfm --pattern "IMG_0001_{n}_{u}_{v}.png" --disparities -1:0:41
      clplen depth simulated/raw.h5 -o depth.ome.tif --metric z.pfm
      clplen depth scene.h5 -o depth.pfm --intrinsics camera.json --metric z.pfm

    For a raw image of a focused camera the map holds m = b/a. A file .h5 also holds m of every
    sub-image; .ome.tif also holds virtual depth, distances and confidence.
    """
    from clplen import plot
    from clplen.io import write_depth
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.rendering import through
    from clplen.plot.base import verbatim

    check_planes(disparities, alphas)
    lengths = metric.lengths_of(arguments)
    picture = output.with_suffix(".png")
    if is_focused_raw(source, {"m": ms, "focused": focused, "image": image}):
        refuse_options(cue=cue, aperture=aperture, disparities=disparities, alphas=alphas)
        refuse_options(memory=memory, intrinsics=arguments["intrinsics"])
        refuse_options(baseline_mm=lengths.camera if lengths else None)
        maps, more = (confidence,), (output, picture)
        _check_names(source, arguments, maps, lengths, *more)
        check_suffix(output, SUFFIXES)
        files = [path for path in (*more, confidence) if path is not None]
        check_raw_picture(source, image, *files)
        find_depth(
            open_raw(source, selector, arguments, image),
            output,
            ms=ms,
            step=arguments["step"],
            confidence=confidence,
            metric=lengths.metric if lengths else None,
            ply=lengths.ply if lengths else None,
            title=source.name,
        )
        return
    _check_names(source, arguments, (output, confidence), lengths, picture)
    with _opened(source, selector, arguments, memory) as (source_light_field, device):
        if isinstance(source_light_field, LightField):
            note_nearly_black(source_light_field, aperture)
        lf = through(source_light_field, aperture)
        if lengths is not None:
            metric.check_camera(lf, lengths)
        planes = planes_of(lf, disparities, alphas)
        depth = _depth(lf, device, cue, memory, planes)
        text = metric.MetricText("", ())
        if lengths is not None:
            text = metric.write(lf, depth, lengths)
    if output.suffix.lower() == ".npy":
        metric.write_map(output, depth.disparity)
    else:
        write_depth(output, depth, spacing=lf.spacing, replace=True)
    if confidence is not None:
        metric.write_map(confidence, depth.confidence)
    plot.save(plot.depth(depth, title=f"disparity of {verbatim(source.name)}"), picture)
    valid = depth.disparity[np.isfinite(depth.disparity)]
    tried_disparities = disparities_of(lf, planes)
    noted = note_end(
        tried_disparities, valid, "for more than half of the pixels the sharpest plane is"
    )
    extra = "" if confidence is None else f", {confidence} holds their confidence"
    view = f"{picture} shows them" + (" with their confidence" if confidence is None else "")
    click.echo(f"{output} holds the disparities, {view}{extra}{''.join(text.files)}.")
    click.echo(_summary(depth))
    fraction = fraction_at_ends(tried_disparities, valid)
    if fraction > MAX_AT_ENDS and not noted:
        click.echo(
            f"{100 * fraction:.0f} % of the pixels lie at the first or last plane: give a wider "
            "range of --disparities."
        )
    if text.distances:
        click.echo(text.distances)


@contextmanager
def _opened(
    source: Path, selector: str | None, layout: dict[str, Any], memory: int | None
) -> Iterator[tuple[LightField | StoredLightField, Device]]:
    """Open the light field, read at once or, with a memory limit, in tiles; and its device."""
    if memory is None:
        lf = read(source, selector, layout)
        yield lf, lf.device
    else:
        with open_stored(source, selector, layout) as pair:
            yield pair


def _depth(
    lf: LightField | StoredLightField,
    device: Device,
    cue: str | None,
    memory: int | None,
    planes: dict[str, Any],
) -> DepthMap:
    from clplen.lightfield.focus_and_depth import depth_map
    from clplen.lightfield.model.stored_light_field import StoredLightField

    if not isinstance(lf, StoredLightField):
        return depth_map(lf, cue=cue, **planes)
    with tile_progress() as progress:
        return depth_map(lf, cue=cue, memory=memory, device=device, progress=progress, **planes)


def _check_names(
    source: Path,
    layout: dict[str, Any],
    maps: tuple[Path | None, ...],
    lengths: metric.Lengths | None,
    *more: Path,
) -> None:
    """Reject maps with another suffix, outputs of equal name, and unwritable outputs."""
    requested = [*maps, lengths.metric if lengths else None]
    outputs = [path for path in requested if path is not None]
    for path in outputs:
        check_suffix(path, _MAPS)
    outputs += more
    if lengths is not None and lengths.ply is not None:
        check_suffix(lengths.ply, (".ply", ".glb"))
        outputs.append(lengths.ply)
    for path in outputs:
        if outputs.count(path) > 1:
            raise click.UsageError(f"{path} is used for two outputs: choose different names.")
    check_outputs(source, layout, *outputs)


def _summary(depth: DepthMap) -> str:
    """Return the range of the disparities and the fraction of reliable pixels as text."""
    reliable = depth.confidence > RELIABLE_ABOVE
    percent = 100 * reliable.mean()
    share = f"{percent:.0f} % of the pixels are reliable (confidence above {RELIABLE_ABOVE:g})"
    valid = depth.disparity[np.isfinite(depth.disparity)]
    if not valid.size or depth.confidence.max() <= MIN_CONFIDENCE:
        return f"{share}: the views show too little detail to measure disparities."
    low, high = np.percentile(valid, [1, 99])
    text = f"98 % of the disparities lie from {low:.3f} to {high:.3f}; {share}"
    if not reliable.any():
        return f"{text}: the views show little detail, or differ in brightness."
    low, high = depth.disparity[reliable].min(), depth.disparity[reliable].max()
    return f"{text}; their minimum is {low:.3f}, their maximum {high:.3f}."
