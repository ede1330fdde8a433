"""What the figure scripts share: command line, device or camera, printed numbers, picture."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from clplen import ClplenError, Device, Image, LightField, demo, plot
from clplen.cameras import Plenoptic1

FOLDER = "clplen-figures"
QUICK_COUNT = 75  # lenslets of the reduced camera: its window still takes every ray of A, B and C
BLUE, GREEN, ORANGE, RED = "#0072b2", "#009e73", "#e69f00", "#cc3311"  # colour-blind readers too
COLOURS = dict(zip(demo.POINTS, (BLUE, GREEN, RED), strict=True))
PAPER = {"facecolor": "w", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}  # behind words on lines


@dataclass(frozen=True)
class Run:
    """One run of a script: what it computes on and where the picture goes."""

    device: Device
    quick: bool
    picture: Path

    def save(self, figure: Figure) -> None:
        """Write the picture and say where it is."""
        plot.save(figure, self.picture, dpi=160)
        print(f"  -> {self.picture}")


@dataclass(frozen=True)
class Example(Run):
    """One run of a script of chapter 3, with the camera of section 1.5."""

    camera: Plenoptic1

    def point(self, position: tuple[float, float, float]) -> LightField:
        """Light field of one source of 10 um at (x, y, dz) in metres."""
        return LightField.from_raw(demo.expose_point(self.camera, position))


def begin(text: str, script: str, *, quick: str = "less to compute") -> Run:
    """Read the command line of a script, given its docstring, its path and what --quick means."""
    parser = argparse.ArgumentParser(description=text)
    parser.add_argument("-o", "--output", default=FOLDER, metavar="FOLDER",
                        help="folder for the picture (default: %(default)s)")
    parser.add_argument("--device", help="as for Device.open, for example cpu, gpu, pocl or 0:1")
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--format", choices=("png", "pdf", "svg"), default="png",
                        help="of the picture (default: %(default)s)")
    given = parser.parse_args()
    try:
        folder, device = Path(given.output), Device.open(given.device)
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        parser.error(f"{given.output} is no folder: there is a file of this name.")
    except (ClplenError, OSError) as error:
        parser.error(str(error))
    matplotlib.rc("font", size=9)
    matplotlib.rc("axes", titlesize=9)
    matplotlib.rc("figure", labelsize=8)
    matplotlib.rc("legend", fontsize=8, frameon=False)
    print(text)
    return Run(device, given.quick, folder / f"{Path(script).stem}.{given.format}")


def start(text: str, script: str) -> Example:
    """As `begin`, with the camera of section 1.5."""
    run = begin(text, script,
                quick=f"less to compute; a camera of {QUICK_COUNT} x {QUICK_COUNT} lenslets")
    camera = demo.camera(run.device, count=QUICK_COUNT) if run.quick else demo.camera(run.device)
    return Example(run.device, run.quick, run.picture, camera)


def number(what: str, value: float, reference: float, within: float, form: str = ".4f") -> None:
    """Print a number beside its reference value and how near it is to come, and say if it fails."""
    found, expected = f"{value:{form}}", f"{reference:{form}}"
    near = abs(float(found) - float(expected)) <= within  # as printed; never of NaN
    verdict = "" if near else "   OUT OF TOLERANCE"
    print(f"  {what:<48} {found:>10}   reference {expected:>10} +- {within:g}{verdict}")


def pixels(image: Image) -> Any:
    """Pixels of an image on the host, float64."""
    return image.to_numpy().astype(float)


def mm(dz: float) -> str:
    """A depth as text."""
    return f"{dz * 1e3:+.0f} mm" if dz else "0 mm"
