"""``clplen microscope pupil``: aberrations of a microscope from its own frames."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.microscopy.volume_inputs import Numbers
from clplen.cli.shared import options
from clplen.cli.shared.console import (
    check_output,
    check_suffix,
    note,
    open_device,
    progress_bar,
    update_bar,
)
from clplen.cli.shared.setting_options import setting_options
from clplen.microscopy.settings import DeconvolutionSettings, LatticeSettings
from clplen.outputs import MARK

if TYPE_CHECKING:
    from clplen.config.microscope import MicroscopeFile
    from clplen.microscopy.pupil.pupil_fit import PupilFit

_PATH = click.Path(path_type=Path)
VOXELS, CUT = 3, 0.02  # of the point images that tell hot pixels: few, and their bright part
_NAMES = {
    5: "astigmatism, oblique", 6: "astigmatism", 7: "coma along y", 8: "coma along x",
    9: "trefoil", 10: "trefoil, oblique", 11: "spherical aberration",
}  # fmt: skip
_KEY = re.compile(r"^\s*pupil_nm\s*=.*$", re.MULTILINE)


@click.command()
@click.argument("frame", metavar="FRAME", type=_PATH)
@click.option(
    "-c", "--camera", "source", required=True, metavar="CAMERA.toml", type=_PATH,
    help="Parameters of the microscope, as of psf; its pupil_nm is where the fit begins.",
)  # fmt: skip
@click.option("-o", "--output", metavar="PUPIL.toml", type=_PATH,
              help="The same parameters with the pupil that was found, for psf.")  # fmt: skip
@click.option(
    "--planes-um", type=options.Planes(), required=True,
    help="z of the planes of the volume, or that beads are looked for on; few do.",
)  # fmt: skip
@click.option("--beads", is_flag=True, help="The frame is one of beads: fit each of them.")
@click.option(
    "--terms", default="5,6,7,8,9,10,11", show_default=True,
    type=Numbers("j,j,...", "5,6,7,8,11", tuple(range(1, 100)), of=" of Noll's indices", kind=int),
    help="Noll's indices to fit, from 5 on.",
)  # fmt: skip
@click.option("--white", type=_PATH, help="White frame; without it the frame is rectified already.")
@click.option("--dark", type=_PATH, help="Dark frame.")
@setting_options(LatticeSettings, "mask")
@setting_options(DeconvolutionSettings, "gain", "haze", "keep_hot")
@click.option("--voxels", type=click.IntRange(1), default=3, show_default=True,
              help="Of a lenslet along an axis.")  # fmt: skip
@click.option("--binning", type=click.IntRange(1), help="As of psf.")
@click.option("--steps", type=click.IntRange(1), default=3, show_default=True, help="At most.")
@options.force
@options.device
def pupil(
    frame: Path,
    source: Path,
    output: Path | None,
    planes_um: Any,
    white: Path | None,
    dark: Path | None,
    mask: Path | None,
    keep_hot: bool,
    gain: float | None,
    haze: bool,
    beads: bool,
    terms: tuple[int, ...],
    voxels: int,
    binning: int | None,
    steps: int,
    force: bool,
    selector: str | None,
) -> None:
    """Find the aberrations of objective and sample from a frame of beads or of anything.

    Printed are Zernike coefficients in nm of path, rms over the pupil, with their standard errors
    by photon noise, and the residual before and after. PUPIL.toml goes to psf in place of
    CAMERA.toml.

    \b
    Example:
      clplen microscope pupil beads.tif -c scope.toml --planes-um -30:30:13 --beads -o found.toml
      clplen microscope psf found.toml -o psf.h5 --planes-um -24.5:24.5:50
    """
    from clplen.config.microscope import read_microscope_file
    from clplen.files import naming, replacing
    from clplen.microscopy.deconvolution_files import read_picture
    from clplen.microscopy.frames.prepare import preparation
    from clplen.microscopy.pupil.pupil_fit import fit_pupil

    DeconvolutionSettings(haze=haze).require_white(white is not None)
    if gain is None:
        note("each count is taken as a photon, which the standard errors depend on: give --gain.")
    if output is not None:
        check_suffix(output, (".toml",))
        check_output(output, force, [path for path in (frame, source, white, dark, mask) if path])
    file = read_microscope_file(source, binning=binning)
    if not file.rectified:
        raise click.ClickException(
            f"The lenslets of {source} are {_lenslets(file)}, whose frames are not rectified, and "
            "a pupil is fitted to rectified frames alone: give a square array of one focal length, "
            "or write a pupil that is known as pupil_nm."
        )
    if file.binning < file.least:
        raise click.UsageError(
            f"--binning {file.binning} does not sample the light, which takes at least "
            f"{file.least} x {file.least} parts of a pixel: leave it out."
        )
    text = None if output is None else source.read_text(encoding="utf-8")
    picture = read_picture(frame)
    camera: Any = file.camera.build(open_device(selector))
    n = round(camera.pixels_per_lenslet) // file.binning
    beside: dict[str, Any] = {
        name: read_picture(path)
        for name, path in (("white", white), ("dark", dark), ("mask", mask))
        if path
    }
    z = np.sort(planes_um) / 1e6
    if not keep_hot:
        beside["sharpest"] = _sharpness(camera, z, file.binning)
    with naming(str(white or mask or frame)):
        prepare = preparation(n, device=camera.device, force=force, **beside)
    with naming(str(frame)):
        seen = prepare(picture)
    if seen.hot:
        note(f"{seen.hot:,} hot pixels, which stand out as no light does, are left out.")
    of_what: dict[str, Any] = {"beads": "find"} if beads else {"steps": steps}
    with progress_bar(0, "plane") as bar:
        found = fit_pupil(
            seen.counts,
            camera,
            planes=z,
            voxels_per_lenslet=voxels,
            white=seen.white,
            background=prepare.haze(seen.counts, seen.white) if haze else 0.0,
            binning=file.binning,
            terms=terms,
            gain=gain or 1.0,
            variance=prepare.variance,
            progress=lambda done, total: update_bar(bar, done, total),
            **of_what,
        )
    _tell(found)
    if output is not None:
        assert text is not None
        with replacing(output) as temporary:
            temporary.write_text(with_pupil(text, found, source), encoding="utf-8")
        click.echo(f"{output} holds the parameters with this pupil.")


def _lenslets(file: MicroscopeFile) -> str:
    array = file.camera.microlenses
    kinds = len(array.focal_length_mm)
    return "of several focal lengths" if kinds > 1 else array.lattice


def _sharpness(camera: Any, z: Any, binning: int) -> tuple[float, float, float]:
    """How far light of the parameters stands out of the pixels around it."""
    from clplen.microscopy.frames.sharpness import chosen_planes, sharpness
    from clplen.microscopy.model.psf import point_images

    how: dict[str, Any] = {"binning": binning, "voxels_per_lenslet": VOXELS, "cut": CUT}
    return sharpness(point_images(camera, z[chosen_planes(len(z))], **how))


def _tell(found: PupilFit) -> None:
    if found.positions is not None:
        click.echo(f"{len(found.positions)} beads")
    click.echo("term   nm of path, rms")
    for j, c, error in zip(found.terms, found.coefficients, found.errors, strict=True):
        click.echo(f"{j:4} {c * 1e9:8.1f} +- {error * 1e9:<6.1f} {_NAMES.get(j, '')}".rstrip())
    click.echo(
        f"{found.pupil.rms * 1e9:.1f} nm rms in all; residual {found.residuals[0]:.4g} before, "
        f"{found.residuals[-1]:.4g} after; chi2 {found.chi2:.3g} (photon noise alone: 1)."
    )


def with_pupil(text: str, found: PupilFit, source: Path) -> str:
    """A camera file with the pupil that was found in place of its own."""
    terms = ", ".join(f"{j} = {c * 1e9:.3f}" for j, c in found.pupil.terms)
    line = f"pupil_nm = {{ {terms} }}  # Noll's index to nm of path, rms over the pupil\n"
    text = _KEY.sub("", text)
    if re.search(r"pupil_nm\s*\]", text):
        raise click.ClickException(
            f"{source} has its pupil as a table of its own: write it as pupil_nm = {{ 6 = 30.0 }}."
        )
    table = re.search(r"^\s*\[camera\].*\n", text, re.MULTILINE)
    at = table.end() if table else 0
    text = text[:at] + line + text[at:]
    return text if MARK in text else f"{text.rstrip()}\n# {MARK}\n"
