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
                    f"OpenCL failed ({reason}): run `clplen devices --check` to test the device, "
                    "or choose another device with --device."
                ) from error


def _opencl_errors() -> tuple[type[Exception], ...]:
    """Return the exception class of OpenCL, once pyopencl is loaded."""
    opencl = sys.modules.get("pyopencl")
    return () if opencl is None else (opencl.Error,)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    note(str(message))


def note(text: str) -> None:
    """Print a note on standard error."""
    click.echo(f"Note: {text}", err=True)


def error_sentence(error: BaseException) -> str:
    """Return the error as one sentence, without a compiler's log."""
    if isinstance(error, MemoryError):
        detail = str(error).rstrip(".")
        return "This computer has too little memory" + (f": {detail}." if detail else ".")
    return reason_of(error) or type(error).__name__


# Minimum rms detail, as a fraction of the brightest pixel: float32 rounding stays below it.
MIN_DETAIL = 1e-5


def open_device(selector: str | None) -> Device:
    """Open the device, and print its name and FFT library."""
    from clplen.compute.device import Device

    device = Device.open(selector)
    parts = [f"{device.name} ({device.driver})", f"{device.precision} precision"]
    parts += [f"FFT by {device.fft.name}", *filter(None, [device.tuning.note])]
    click.echo(f"Device: {', '.join(parts)}\n")
    return device


def progress_bar(total: int, unit: str) -> tqdm[Any]:
    return tqdm(total=total, unit=unit, disable=not sys.stderr.isatty(), leave=False)


def advance(bar: tqdm[Any], name: str) -> None:
    bar.set_description(name)
    bar.update()


def update_bar(bar: tqdm[Any], done: int, total: int) -> None:
    """Set the bar to ``done`` of ``total``; reset it when the next part begins."""
    if done < bar.n:
        bar.reset()
    bar.total = total
    bar.update(done - bar.n)


@contextmanager
def capture_messages() -> Iterator[list[str]]:
    """Collect the log messages of the readers instead of printing them."""
    messages: list[str] = []
    logger = logging.getLogger("clplen.io")
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())  # type: ignore[method-assign]
    propagated = logger.propagate
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield messages
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
def open_stored(
    source: Path, selector: str | None, layout: dict[str, Any]
) -> Iterator[tuple[StoredLightField, Device]]:
    """Open a light field for reading part by part, and its device."""
    from clplen.compute.device import Device
    from clplen.io import open_lightfield

    device = Device.open(selector)
    with open_lightfield(source, device=device, **layout) as light_field:
        yield light_field, device


@contextmanager
def tile_progress() -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar of tiles."""
    with progress_bar(0, "tile") as bar:
        yield lambda done, total: update_bar(bar, done, total)


def check_planes(disparities: Any, alphas: Any) -> None:
    """Raise an error if both disparities and alphas are given."""
    one_of_planes(alphas, disparities)


def note_end(disparities: Any, sharpest: Any, what: str = "the sharpest plane is") -> bool:
    """Warn if the sharpest plane is the first or the last; return True in this case.

    ``sharpest`` is a disparity, or the disparities of many pixels, whose majority decides.
    """
    planes = np.asarray(disparities, np.float64)
    if planes.size < 3:
        return False
    ends = np.sort(planes)[[0, 1, -2, -1]]
    if np.mean(sharpest < (ends[0] + ends[1]) / 2) > 0.5:
        end, side = ends[0], "below"
    elif np.mean(sharpest > (ends[2] + ends[3]) / 2) > 0.5:
        end, side = ends[3], "above"
    else:
        return False
    end_name = "first" if end == planes[0] else "last"
    note(
        f"{what} the {end_name} plane tried: the scene may extend {side} disparity {end:g}; "
        "'clplen info' estimates its range."
    )
    return True


def note_nearly_black(lf: LightField, aperture: Any) -> None:
    """Warn if views inside the aperture are nearly black."""
    from clplen.lightfield.axis_check.view_brightness import (
        NEARLY_BLACK,
        clear_aperture,
        nearly_black_views,
        relative_brightness,
    )
    from clplen.lightfield.model.apertures import aperture_weights

    is_dark = nearly_black_views(lf, relative_brightness(lf))
    is_dark &= aperture_weights(lf, aperture, None) > 0
    if not is_dark.any():
        return
    across = clear_aperture(lf, is_dark)
    note(
        f"{is_dark.sum()} of {is_dark.size} views are nearly black (below {100 * NEARLY_BLACK:g} % "
        "of the median brightness) and are weighted like the others"
        + (f": --aperture {across} leaves them out." if across else ".")
    )


def fraction_at_ends(disparities: Any, measured: Any) -> float:
    """Return the fraction of measured disparities whose nearest plane is the first or last."""
    planes = np.sort(np.asarray(disparities, np.float64))
    if planes.size < 3 or not np.size(measured):
        return 0.0
    low, high = planes[:2].mean(), planes[-2:].mean()
    return float(np.mean((measured < low) | (measured > high)))


def sharpest_plane(stack: FocalStack, lf: LightField) -> int | str:
    """Return the index of the sharpest plane, or the reason why no plane is the sharpest."""
    from clplen.lightfield.depth.depth_maps import sharpness_curve

    if np.count_nonzero(lf.weights) < 2:
        return "a single view looks alike on every plane"
    curve = sharpness_curve(stack)
    best = int(curve.argmax())
    level = float(np.abs(stack.device.download(stack.data[best])).max())
    if curve[best] <= (MIN_DETAIL * level) ** 2:
        return "the views show no detail" + ("" if level else ", they are black")
    return best


def planes_of(
    lf: LightField | StoredLightField, disparities: Any, alphas: Any, *, count: int | None = None
) -> dict[str, Any]:
    """Return the given planes, else ``count`` planes over the range of the light field."""
    from clplen.lightfield.depth.best_focus import suitable_planes
    from clplen.lightfield.model.alpha_law import shifts

    if disparities is None and alphas is None:
        planes = suitable_planes(lf, count=count)
    else:
        name, values = ("alphas", alphas) if disparities is None else ("disparities", disparities)
        planes = {name: np.array(values)}
    chosen = disparities_of(lf, planes)
    largest = [np.abs(axis).reshape(len(axis), -1).max(axis=1) for axis in shifts(lf, chosen)]
    beyond = (largest[0] >= lf.shape[2]) | (largest[1] >= lf.shape[3])
    if beyond.any():
        note(
            f"{beyond.sum()} of {options.planes(beyond.size)} shift the outermost views by more "
            "than the size of a picture and leave gaps: choose planes nearer to disparity 0."
        )
    return planes


def disparities_of(lf: LightField | StoredLightField, planes: dict[str, Any]) -> Any:
    """Return the disparities of planes from `planes_of`."""
    return planes["disparities"] if "disparities" in planes else lf.disparity(planes["alphas"])


def check_outputs(source: Path, layout: dict[str, Any], *outputs: Path) -> None:
    """Reject outputs that cannot be written, are inputs, or were not written by clplen."""
    from clplen.io.lightfields.lightfield_files import files_of

    with capture_messages():  # the reader logs the messages again
        files = files_of(source, **layout) if any(path.exists() for path in outputs) else []
    for output in outputs:
        check_output(output, layout["force"], files, f" of {source}")


def check_output(output: Path, force: bool, inputs: Iterable[Path], of: str = "") -> None:
    """Reject an output that cannot be written, is an input, or was not written by clplen.

    ``of`` names the source of the inputs for the message.
    """
    from clplen import outputs

    for file in inputs:
        if output.exists() and file.exists() and file.samefile(output):
            raise click.UsageError(
                f"{output} is one of the input files{of}: choose another output."
            )
    outputs.check_output(output, force=force)


def note_link(folder: Path | str) -> None:
    """Print the target of an output folder that is a symbolic link."""
    if Path(folder).is_symlink():
        note(f"{folder} is a link: files are written to {Path(folder).resolve()}.")


def check_suffix(output: Path, suffixes: tuple[str, ...]) -> None:
    if output.suffix.lower() not in suffixes:
        raise click.UsageError(f"The output must end in {' or '.join(suffixes)}, got {output}.")
