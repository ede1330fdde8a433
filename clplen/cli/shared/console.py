"""Messages, progress bars and checks of outputs on the command line."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from tqdm import tqdm

from clplen import interrupts
from clplen.cli.shared import options
from clplen.errors import ClplenError, arguments_as, reason_of
from clplen.settings.declaration import SettingError
from clplen.settings.light_fields import one_of_planes

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.stored_light_field import StoredLightField
    from clplen.lightfield.refocusing.focal_stacks import FocalStack

class Commands(click.Group):
    """Commands whose expected failures are one sentence, not a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        with interrupts.unwinding(), warnings.catch_warnings(), arguments_as("command"):
            warnings.showwarning = _show_warning
            try:
                return super().invoke(ctx)
            except KeyboardInterrupt:
                if interrupts.is_command():
                    interrupts.leave()
                click.echo(f"\n{interrupts.SENTENCE}", err=True)
                ctx.exit(interrupts.STATUS)
            except BrokenPipeError:
                raise
            except SettingError as error:
                raise click.UsageError(str(error)) from error
            except (ClplenError, ValueError, OSError, MemoryError) as error:
                raise click.ClickException(error_sentence(error)) from error
            except ImportError as error:
                if "failed to map segment" not in str(error):  # a limit of address space
                    raise
                raise click.ClickException(error_sentence(MemoryError(str(error)))) from error
            except _opencl_errors() as error:
                reason = (str(error).splitlines() or [type(error).__name__])[0]
                raise click.ClickException(
                    f"OpenCL failed ({reason}): run `clplen devices --check` to see what works, or "
                    "choose another device by --device."
                ) from error


def _opencl_errors() -> tuple[type[Exception], ...]:
    """What OpenCL raises, where it is in use."""
    opencl = sys.modules.get("pyopencl")
    return () if opencl is None else (opencl.Error,)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    note(str(message))


def note(text: str) -> None:
    """Say something on standard error that does not end the command."""
    click.echo(f"Note: {text}", err=True)


def error_sentence(error: BaseException) -> str:
    """Return what went wrong, without a compiler's log."""
    if isinstance(error, MemoryError):
        detail = str(error).rstrip(".")
        return "This computer has not enough memory" + (f": {detail}." if detail else " for it.")
    return reason_of(error) or type(error).__name__


_DETAIL = 1e-5  # of the brightest pixel, rms: what is less is rounding


def open_device(selector: str | None) -> Device:
    """The device and its way to transform, named before anything is computed."""
    from clplen.compute.device import Device

    device = Device.open(selector)
    click.echo(f"Device: {device!r}, FFT by {device.fft.name}\n")
    return device


def progress_bar(total: int, unit: str) -> tqdm[Any]:
    return tqdm(total=total, unit=unit, disable=not sys.stderr.isatty(), leave=False)


def advance(bar: tqdm[Any], name: str) -> None:
    bar.set_description(name)
    bar.update()


def update_bar(bar: tqdm[Any], done: int, total: int) -> None:
    """How far one part of several has come; each begins anew."""
    if done < bar.n:
        bar.reset()
    bar.total = total
    bar.update(done - bar.n)


@contextmanager
def capture_messages() -> Iterator[list[str]]:
    """What the readers say, kept instead of being shown."""
    said: list[str] = []
    logger = logging.getLogger("clplen.io")
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    propagated = logger.propagate
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield said
    finally:
        logger.propagate = propagated
        logger.removeHandler(handler)


def describe_shape(lf: LightField) -> str:
    return "(v, u, y, x) = (" + ", ".join(str(n) for n in lf.shape) + ")"


def read(source: Path, selector: str | None, layout: dict[str, Any]) -> LightField:
    from clplen.compute.device import Device
    from clplen.io import read_lightfield

    return read_lightfield(
        source, device=Device.open(selector), progress=sys.stderr.isatty(), **layout
    )


@contextmanager
def stored(
    source: Path, selector: str | None, layout: dict[str, Any]
) -> Iterator[tuple[StoredLightField, Device]]:
    """A light field that is read part by part, and the device for it."""
    from clplen.compute.device import Device
    from clplen.io import open_lightfield

    device = Device.open(selector)
    with open_lightfield(source, device=device, **layout) as found:
        yield found, device


@contextmanager
def tile_progress() -> Iterator[Callable[[int, int], None]]:
    """What shows how many tiles are done."""
    with progress_bar(0, "tile") as bar:
        yield lambda done, total: update_bar(bar, done, total)


def check_planes(disparities: Any, alphas: Any) -> None:
    """Refuse planes that are given in both ways."""
    one_of_planes(alphas, disparities)


def note_end(disparities: Any, found: Any, what: str = "the sharpest plane is") -> bool:
    """Say that the best of several planes is the first or the last one, if it is.

    ``found`` is its disparity, or those of many pixels, of which more than half count.
    """
    planes = np.asarray(disparities, np.float64)
    if planes.size < 3:
        return False
    ends = np.sort(planes)[[0, 1, -2, -1]]
    if np.mean(found < (ends[0] + ends[1]) / 2) > 0.5:
        end, side = ends[0], "below"
    elif np.mean(found > (ends[2] + ends[3]) / 2) > 0.5:
        end, side = ends[3], "above"
    else:
        return False
    which = "first" if end == planes[0] else "last"
    note(
        f"{what} the {which} of those tried: the scene may lie {side} disparity {end:g}; "
        "'clplen info' finds its range."
    )
    return True


def note_nearly_black(lf: LightField, aperture: Any) -> None:
    """Say that some of the views that an aperture takes hold hardly any light, if they do."""
    from clplen.lightfield.axis_check.view_brightness import (
        NEARLY_BLACK,
        clear_aperture,
        nearly_black_views,
        relative_brightness,
    )
    from clplen.lightfield.model.apertures import aperture_weights

    dim = nearly_black_views(lf, relative_brightness(lf))
    dim &= aperture_weights(lf, aperture, None) > 0
    if not dim.any():
        return
    across = clear_aperture(lf, dim)
    note(
        f"{dim.sum()} of {dim.size} views are nearly black (below {100 * NEARLY_BLACK:g} % of the "
        "median brightness) and count like the others"
        + (f": --aperture {across} leaves them out." if across else ".")
    )


def share_at_ends(disparities: Any, found: Any) -> float:
    """Share of some disparities that are nearer to the first or last plane than to the others."""
    planes = np.sort(np.asarray(disparities, np.float64))
    if planes.size < 3 or not np.size(found):
        return 0.0
    low, high = planes[:2].mean(), planes[-2:].mean()
    return float(np.mean((found < low) | (found > high)))


def sharpest_of(stack: FocalStack, lf: LightField) -> int | str:
    """Which plane is the sharpest, or why none is: there is one view, or nothing to be sharp."""
    from clplen.lightfield.depth.depth_maps import sharpness_curve

    if np.count_nonzero(lf.weights) < 2:
        return "there is one view only, which looks the same on every plane"
    curve = sharpness_curve(stack)
    best = int(curve.argmax())
    level = float(np.abs(stack.device.download(stack.data[best])).max())
    if curve[best] <= (_DETAIL * level) ** 2:
        return "the views show no detail" + ("" if level else ", they are black")
    return best


def planes_of(
    lf: LightField | StoredLightField, disparities: Any, alphas: Any, *, count: int | None = None
) -> dict[str, Any]:
    """The planes that were asked for, else those that suit the light field, `count` of them."""
    from clplen.lightfield.depth.best_focus import suitable_planes
    from clplen.lightfield.model.alpha_law import shifts

    if disparities is None and alphas is None:
        planes = suitable_planes(lf, count=count)
    else:
        name, given = ("alphas", alphas) if disparities is None else ("disparities", disparities)
        planes = {name: np.array(given)}
    chosen = tried_disparities(lf, planes)
    moved = [np.abs(along).reshape(len(along), -1).max(axis=1) for along in shifts(lf, chosen)]
    beyond = (moved[0] >= lf.shape[2]) | (moved[1] >= lf.shape[3])
    if beyond.any():
        note(
            f"{beyond.sum()} of {options.planes(beyond.size)} move the outermost views by more "
            "than a whole picture, so that parts stay empty: choose planes nearer to disparity 0."
        )
    return planes


def tried_disparities(lf: LightField | StoredLightField, planes: dict[str, Any]) -> Any:
    """The disparities of `planes_of`."""
    return planes["disparities"] if "disparities" in planes else lf.disparity(planes["alphas"])


def check_outputs(source: Path, layout: dict[str, Any], *outputs: Path) -> None:
    """Refuse outputs that cannot be written, are read, or were not written by clplen."""
    from clplen.io.lightfields.lightfield_files import files_of

    with capture_messages():  # reading says it again
        files = files_of(source, **layout) if any(path.exists() for path in outputs) else []
    for output in outputs:
        check_output(output, layout["force"], files, f" of {source}")


def check_output(output: Path, force: bool, inputs: Iterable[Path], of: str = "") -> None:
    """Refuse an output that cannot be written, is read, or was not written by clplen.

    ``of`` tells what the inputs belong to.
    """
    from clplen import outputs

    for file in inputs:
        if output.exists() and file.exists() and file.samefile(output):
            raise click.UsageError(
                f"{output} is one of the files{of} that are read: name an output elsewhere."
            )
    outputs.check_output(output, force=force)


def note_link(folder: Path | str) -> None:
    """Say where files go if an output folder is a link."""
    if Path(folder).is_symlink():
        note(f"{folder} is a link: files go to {Path(folder).resolve()}.")


def check_suffix(output: Path, suffixes: tuple[str, ...]) -> None:
    if output.suffix.lower() not in suffixes:
        raise click.UsageError(f"The output ends in {' or '.join(suffixes)}, not as {output}.")
