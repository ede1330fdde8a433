"""The command ``clplen``."""

from __future__ import annotations

import logging
import sys
from io import TextIOWrapper

import click

from clplen import __version__
from clplen.cli.analyse import analyse
from clplen.cli.batch import batch, worker
from clplen.cli.bench import bench
from clplen.cli.calibrate import calibrate
from clplen.cli.demo import demo
from clplen.cli.depth import depth
from clplen.cli.devices import devices
from clplen.cli.displays.lenticular import lenticular
from clplen.cli.displays.poses import poses
from clplen.cli.displays.quilt import quilt
from clplen.cli.displays.stereo import stereo
from clplen.cli.epi import epi
from clplen.cli.info import info
from clplen.cli.microscopy.deconvolve import deconvolve
from clplen.cli.microscopy.microscope import microscope
from clplen.cli.microscopy.pupil import pupil
from clplen.cli.microscopy.traces import traces
from clplen.cli.microscopy.tracks import points, regions, track
from clplen.cli.microscopy.views import views
from clplen.cli.refocus import refocus
from clplen.cli.render import render
from clplen.cli.sampling import sampling
from clplen.cli.score import score
from clplen.cli.shared.console import Commands
from clplen.cli.simulate import simulate
from clplen.cli.stack import stack
from clplen.cli.view import view


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="clplen")
def main() -> None:
    """Simulate plenoptic cameras by wave optics, and process light fields on OpenCL devices.

    Start with 'clplen demo'. 'clplen COMMAND -h' shows the options and examples of a command.
    """
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files that are not UTF-8
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    logger = logging.getLogger("clplen")
    logger.handlers = [handler]
    logger.setLevel(logging.INFO)


_COMMANDS = (
    analyse,
    batch,
    bench,
    calibrate,
    demo,
    depth,
    devices,
    epi,
    info,
    lenticular,
    microscope,
    poses,
    quilt,
    refocus,
    render,
    sampling,
    score,
    simulate,
    stack,
    stereo,
    view,
    worker,
)
for command in (deconvolve, points, pupil, regions, track, traces, views):
    microscope.add_command(command)
for command in _COMMANDS:
    main.add_command(command)
