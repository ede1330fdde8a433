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
    note_end,
    note_nearly_black,
    planes_of,
    read,
    share_at_ends,
    stored,
    tile_progress,
    tried_disparities,
)
from clplen.cli.shared.focused import (
    SUFFIXES,
    check_kept,
    depth_words,
    find_depth,
    is_meant,
    refuse,
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
_NOTHING = 1e-3  # confidence of a map that tells nothing, but for rounding
_AT_ENDS = 0.01  # of the pixels: how many may lie at the first or last plane unsaid
_SURE = 0.5  # confidence above which a pixel counts as sure


@click.command(cls=options.Command)
@options.source
@options.output(
    "OUT.pfm|OUT.tif|OUT.npy",
    "Disparities; a picture of the same name in .png is written beside them.",
)
@setting_options(DepthSettings, "aperture", "cue")
@options.file("--confidence", help="Confidence from 0 to 1, as .pfm, .tif or .npy.")
@depth_words
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
    **words: Any,
) -> None:
    """Find the disparity of every pixel: values as PFM, TIFF or NumPy, and a picture.

    \b
    Example:
      clplen depth flower -o flower.pfm --pattern "IMG_0001_{n}_{u}_{v}.png" --disparities -1:0:41
      clplen depth simulated/raw.h5 -o depth.ome.tif --metric z.pfm
      clplen depth scene.h5 -o depth.pfm --intrinsics camera.json --metric z.pfm

    Of a raw image of a focused camera: m = b/a, on its picture; .h5 holds it of every sub-image too
    and .ome.tif the virtual depth, distances and confidence.
    """
    from clplen import plot
    from clplen.io import write_depth
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.rendering import through
    from clplen.plot.base import verbatim

    check_planes(disparities, alphas)
    lengths = metric.lengths_of(words)
    picture = output.with_suffix(".png")
    if is_meant(source, {"m": ms, "focused": focused, "image": image}):
        refuse(cue=cue, aperture=aperture, disparities=disparities, alphas=alphas, memory=memory)
        refuse(intrinsics=words["intrinsics"], baseline_mm=lengths.camera if lengths else None)
        maps, more = (confidence,), (output, picture)
        _check_names(source, words, maps, lengths, *more)
        check_suffix(output, SUFFIXES)
        files = [path for path in (*more, confidence) if path is not None]
        check_kept(source, image, *files)
        find_depth(
            open_raw(source, selector, words, image),
            output,
            ms=ms,
            step=words["step"],
            confidence=confidence,
            metric=lengths.metric if lengths else None,
            ply=lengths.ply if lengths else None,
            title=source.name,
        )
        return
    _check_names(source, words, (output, confidence), lengths, picture)
    with _opened(source, selector, words, memory) as (opened, device):
        if isinstance(opened, LightField):
            note_nearly_black(opened, aperture)
        lf = through(opened, aperture)
        if lengths is not None:
            metric.check_camera(lf, lengths)
        planes = planes_of(lf, disparities, alphas)
        found = _found(lf, device, cue, memory, planes)
        said = metric.write(lf, found, lengths) if lengths is not None else metric.Said("", ())
    if output.suffix.lower() == ".npy":
        metric.write_map(output, found.disparity)
    else:
        write_depth(output, found, spacing=lf.spacing, replace=True)
    if confidence is not None:
        metric.write_map(confidence, found.confidence)
    plot.save(plot.depth(found, title=f"disparity of {verbatim(source.name)}"), picture)
    known = found.disparity[np.isfinite(found.disparity)]
    tried = tried_disparities(lf, planes)
    noted = note_end(tried, known, "for more than half of the pixels the sharpest plane is")
    sure = "" if confidence is None else f", {confidence} holds their confidence"
    shown = f"{picture} shows them" + (" with their confidence" if confidence is None else "")
    click.echo(f"{output} holds the disparities, {shown}{sure}{''.join(said.files)}.")
    click.echo(_summary(found))
    share = share_at_ends(tried, known)
    if share > _AT_ENDS and not noted:
        click.echo(
            f"{100 * share:.0f} % of the pixels lie at the first or last plane: give a wider "
            "--disparities."
        )
    if said.distances:
        click.echo(said.distances)


@contextmanager
def _opened(
    source: Path, selector: str | None, words: dict[str, Any], memory: int | None
) -> Iterator[tuple[LightField | StoredLightField, Device]]:
    """The light field, in core or, with a budget of memory, part by part; and the device."""
    if memory is None:
        lf = read(source, selector, words)
        yield lf, lf.device
    else:
        with stored(source, selector, words) as opened:
            yield opened


def _found(
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
    """Refuse maps of another kind, outputs of the same name, or that cannot be written."""
    wanted = [*maps, lengths.metric if lengths else None]
    outputs = [path for path in wanted if path is not None]
    for path in outputs:
        check_suffix(path, _MAPS)
    outputs += more
    if lengths is not None and lengths.ply is not None:
        check_suffix(lengths.ply, (".ply", ".glb"))
        outputs.append(lengths.ply)
    for path in outputs:
        if outputs.count(path) > 1:
            raise click.UsageError(f"{path} is named for two outputs: give each a name of its own.")
    check_outputs(source, layout, *outputs)


def _summary(found: DepthMap) -> str:
    """The range of the disparities, and how many pixels are sure."""
    sure = found.confidence > _SURE
    share = f"{100 * sure.mean():.0f} % of the pixels are sure (confidence above {_SURE:g})"
    known = found.disparity[np.isfinite(found.disparity)]
    if not known.size or found.confidence.max() <= _NOTHING:
        return f"{share}: what the map holds was not measured, the views show too little detail."
    low, high = np.percentile(known, [1, 99])
    text = f"98 % of the disparities lie from {low:.3f} to {high:.3f}; {share}"
    if not sure.any():
        return f"{text}: the views show little detail, or differ in brightness."
    low, high = found.disparity[sure].min(), found.disparity[sure].max()
    return f"{text}, those from {low:.3f} to {high:.3f}."
