"""``clplen microscope pupil``: estimate the aberrations of a microscope from a frame."""

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
VOXELS, CUT = 3, 0.02  # sampling of the coarse point images for the detection of hot pixels
_NAMES = {
    5: "astigmatism, oblique", 6: "astigmatism", 7: "coma along y", 8: "coma along x",
    9: "trefoil", 10: "trefoil, oblique", 11: "spherical aberration",
}  # fmt: skip
_KEY = re.compile(r"^\s*pupil_nm\s*=.*$", re.MULTILINE)


@click.command()
@click.argument("frame", metavar="FRAME", type=_PATH)
@click.option(
    "-c", "--camera", "source", required=True, metavar="CAMERA.toml", type=_PATH,
    help="Camera file of the microscope, as for psf; the fit starts from its pupil_nm.",
)  # fmt: skip
@click.option("-o", "--output", metavar="PUPIL.toml", type=_PATH,
              help="Output camera file with the estimated pupil, for psf.")  # fmt: skip
@click.option(
    "--planes-um", type=options.Planes(), required=True,
    help="z of the planes of the volume, or of the search for beads, in micrometres. A few planes "
    "suffice.",
)  # fmt: skip
@click.option("--beads", is_flag=True, help="Fit the beads in a frame of isolated beads.")
@click.option(
    "--terms", default="5,6,7,8,9,10,11", show_default=True,
    type=Numbers("j,j,...", "5,6,7,8,11", tuple(range(1, 100)), of=" of Noll's indices", kind=int),
    help="Noll's indices to fit, from 5 on.",
)  # fmt: skip
@click.option(
    "--white", type=_PATH, help="White frame. Without it the frame is assumed to be rectified."
)
@click.option("--dark", type=_PATH, help="Dark frame, subtracted from the frame.")
@setting_options(LatticeSettings, "mask")
@setting_options(DeconvolutionSettings, "gain", "haze", "keep_hot")
@click.option("--voxels", type=click.IntRange(1), default=3, show_default=True,
              help="Number of voxels per lenslet along each axis.")  # fmt: skip
@click.option("--binning", type=click.IntRange(1),
              help="Number of simulated samples per pixel along each axis.")  # fmt: skip
@click.option("--steps", type=click.IntRange(1), default=3, show_default=True,
              help="Maximum number of fit steps.")  # fmt: skip
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
    """Estimate the aberrations of objective and sample from a frame of beads or any sample.

    The command prints Zernike coefficients in nm of optical path (rms over the pupil), their
    standard errors by photon noise, and the residual before and after the fit. Pass PUPIL.toml to
    psf instead of CAMERA.toml.

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
        note("the standard errors assume one photon per count: give --gain.")
    if output is not None:
        check_suffix(output, (".toml",))
        check_output(output, force, [path for path in (frame, source, white, dark, mask) if path])
    file = read_microscope_file(source, binning=binning)
    if not file.rectified:
        raise click.ClickException(
            f"A pupil can be fitted to rectified frames only, but the lenslets of {source} are "
            f"{_lenslets(file)}: use a square array of one focal length, or set pupil_nm in the "
            "camera file."
        )
    if file.binning < file.min_binning:
        raise click.UsageError(
            f"--binning must be at least {file.min_binning} to sample the light, got "
            f"{file.binning}: leave it out."
        )
    text = None if output is None else source.read_text(encoding="utf-8")
    picture = read_picture(frame)
    camera: Any = file.camera.build(open_device(selector))
    n = round(camera.pixels_per_lenslet) // file.binning
    frames: dict[str, Any] = {
        name: read_picture(path)
        for name, path in (("white", white), ("dark", dark), ("mask", mask))
        if path
    }
    z = np.sort(planes_um) / 1e6
    if not keep_hot:
        frames["sharpest"] = _sharpness(camera, z, file.binning)
    with naming(str(white or mask or frame)):
        prepare = preparation(n, device=camera.device, force=force, **frames)
    with naming(str(frame)):
        prepared = prepare(picture)
    if prepared.hot:
        note(f"{prepared.hot:,} hot pixels are ignored; --keep-hot uses them.")
    method_settings: dict[str, Any] = {"beads": "find"} if beads else {"steps": steps}
    with progress_bar(0, "plane") as bar:
        fit = fit_pupil(
            prepared.counts,
            camera,
            planes=z,
            voxels_per_lenslet=voxels,
            white=prepared.white,
            background=prepare.haze(prepared.counts, prepared.white) if haze else 0.0,
            binning=file.binning,
            terms=terms,
            gain=gain or 1.0,
            variance=prepare.variance,
            progress=lambda done, total: update_bar(bar, done, total),
            **method_settings,
        )
    _print_result(fit)
    if output is not None:
        assert text is not None
        with replacing(output) as temporary:
            temporary.write_text(with_pupil(text, fit, source), encoding="utf-8")
        click.echo(f"{output} holds the camera file with this pupil.")


def _lenslets(file: MicroscopeFile) -> str:
    array = file.camera.microlenses
    kinds = len(array.focal_length_mm)
    return "of several focal lengths" if kinds > 1 else array.lattice


def _sharpness(camera: Any, z: Any, binning: int) -> tuple[float, float, float]:
    """Return the sharpness of point images, the limit above which pixels are hot."""
    from clplen.microscopy.frames.sharpness import chosen_planes, sharpness
    from clplen.microscopy.model.psf import point_images

    settings: dict[str, Any] = {"binning": binning, "voxels_per_lenslet": VOXELS, "cut": CUT}
    return sharpness(point_images(camera, z[chosen_planes(len(z))], **settings))


def _print_result(fit: PupilFit) -> None:
    if fit.positions is not None:
        click.echo(f"{len(fit.positions)} beads")
    click.echo("term   nm of path, rms")
    for j, c, error in zip(fit.terms, fit.coefficients, fit.errors, strict=True):
        click.echo(f"{j:4} {c * 1e9:8.1f} +- {error * 1e9:<6.1f} {_NAMES.get(j, '')}".rstrip())
    click.echo(
        f"{fit.pupil.rms * 1e9:.1f} nm rms in total; residual {fit.residuals[0]:.4g} before, "
        f"{fit.residuals[-1]:.4g} after the fit; reduced chi2 {fit.chi2:.3g} (photon noise "
        "alone: 1)."
    )


def with_pupil(text: str, fit: PupilFit, source: Path) -> str:
    """Return the text of a camera file with the estimated pupil."""
    terms = ", ".join(f"{j} = {c * 1e9:.3f}" for j, c in fit.pupil.terms)
    line = f"pupil_nm = {{ {terms} }}  # Noll's index to nm of path, rms over the pupil\n"
    text = _KEY.sub("", text)
    if re.search(r"pupil_nm\s*\]", text):
        raise click.ClickException(
            f"{source} has pupil_nm as a separate table: write it inline, as pupil_nm = {{ 6 = "
            "30.0 }}."
        )
    table = re.search(r"^\s*\[camera\].*\n", text, re.MULTILINE)
    at = table.end() if table else 0
    text = text[:at] + line + text[at:]
    return text if MARK in text else f"{text.rstrip()}\n# {MARK}\n"
