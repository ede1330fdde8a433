"""A Cooke triplet and a double Gauss as OPD maps, beside optiland's own numbers.

Maps are traced at eleven fields and six wavelengths. At five fields and at the lines F, d and C,
two fields and two lines of which lie between those, are compared

- Strehl ratio: clplen's PSF of the maps' pupil over that of the same pupil without wavefront,
  against optiland's FFTPSF of rays that are traced anew, relative; both seen from the best place of
  the peak;
- distortion: place of the maps' chief ray, against optiland's analysis, in percent of the field;
- vignetting: share of the light, against the rays that optiland passes, in percent.

    python examples/lenses/compare_lenses.py [--save FOLDER]
"""

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np
from optiland.analysis import Distortion
from optiland.optic import Optic
from optiland.psf import FFTPSF
from prescriptions import LENSES, Prescription

from clplen import Grid
from clplen.analysis import PSF
from clplen.cameras import OPDMaps
from clplen.wave import Pupil

FRACTIONS = np.linspace(0, 1, 5)  # of the largest field
LINES = {"F": 486.1e-9, "d": 587.6e-9, "C": 656.3e-9}
TRACED = (587.6e-9, 450e-9, 480e-9, 520e-9, 630e-9, 690e-9)  # the first: the image's scale
STREHL, DISTORTION, VIGNETTING = 1.0, 0.1, 1.0  # percent, percent points, percent points


def our_strehl(maps: OPDMaps, y: float, wavelength: float, samples: int = 1024) -> float:
    """Peak of the PSF of a field's pupil over that without its wavefront."""
    pitch = wavelength * maps.pupil_distance / maps.pupil_diameter / 4
    grid = Grid((samples, samples), (pitch, pitch))
    bent, flat = (
        Pupil(maps.pupil_diameter, maps.pupil_distance, path=path).transfer(grid, wavelength)
        for path in (lambda v, u: maps.path(y, 0, wavelength, v, u), None))
    fc = Pupil(maps.pupil_diameter, maps.pupil_distance).cutoff(wavelength)
    f = np.fft.fftfreq(samples, pitch) / fc
    share, covered = maps.share_and_cover(y, 0, wavelength, f[:, None], f[None, :], f[1])
    passed = np.sqrt(share) * covered
    images = [np.abs(np.fft.fftshift(np.fft.ifft2(H * passed))) ** 2 for H in (bent, flat)]
    bent_psf, flat_psf = (PSF(image / image.sum(), pitch) for image in images)
    return bent_psf.strehl(flat_psf)


def their_strehl(lens: Optic, fraction: float, wavelength: float) -> float:
    """optiland's, over the same pupil without wavefront: glass that absorbs is no aberration."""
    psf = FFTPSF(lens, (0, float(fraction)), wavelength * 1e6, num_rays=257, grid_size=4096)
    amplitude = np.abs(psf.pupils[0])
    return psf.strehl_ratio() * np.count_nonzero(amplitude) ** 2 / amplitude.sum() ** 2


def their_share(lens: Optic, fraction: float, wavelength: float) -> float:
    """Share of the light that passes, by rays all over the entrance pupil."""
    rays = lens.trace(0.0, float(fraction), wavelength * 1e6, 401, "uniform")
    return float(np.nansum(rays.i) / np.size(rays.i))


def compare(prescription: Prescription, folder: Path | None) -> bool:
    """Print the table of a lens; whether all of it is within the tolerances."""
    lens = prescription.optic()
    maps = OPDMaps.traced(lens, fields=11, wavelengths=TRACED, samples=65)
    print(f"\n{prescription.name} ({prescription.source})")
    print(f"exit pupil {maps.pupil_diameter * 1e3:.3f} mm at {maps.pupil_distance * 1e3:.3f} mm, "
          f"image up to {maps.fields[-1, 0] * 1e3:.3f} mm")
    print("field line | Strehl  optiland  off %  | distortion %  optiland   off  | light %  "
          "optiland  off")
    if folder is not None:
        maps.save(folder / f"{prescription.name.split(',')[0].replace(' ', '_')}.h5")
    tangents = np.tan(np.radians(FRACTIONS * prescription.field))
    places = maps.fields[-1, 0] * tangents / tangents[-1]
    worst = np.zeros(3)
    for line, wavelength in LINES.items():
        curve = Distortion(lens, wavelengths=[wavelength * 1e6], num_points=len(FRACTIONS)).data[0]
        near = maps.chief_ray(1e-5 * places[-1], 0, wavelength)[0] / (1e-5 * places[-1])
        for fraction, y, theirs in zip(FRACTIONS, places, np.ravel(curve), strict=True):
            strehls = our_strehl(maps, y, wavelength), their_strehl(lens, fraction, wavelength)
            moved = 100 * (maps.chief_ray(y, 0, wavelength)[0] / (y * near) - 1) if y else 0.0
            theirs = float(theirs) if y else 0.0
            shares = maps.passed(y, 0, wavelength), their_share(lens, fraction, wavelength)
            off = (100 * (strehls[0] / strehls[1] - 1), moved - theirs,
                   100 * (shares[0] - shares[1]))
            worst = np.maximum(worst, np.abs(off))
            print(f" {fraction:.2f}  {line}   | {strehls[0]:.4f}  {strehls[1]:.4f}  {off[0]:+6.2f}"
                  f"  | {moved:+9.4f}  {theirs:+9.4f}  {off[1]:+.4f} | {100 * shares[0]:6.2f}  "
                  f"{100 * shares[1]:6.2f}  {off[2]:+.2f}")
    fits = bool((worst <= (STREHL, DISTORTION, VIGNETTING)).all())
    print(f"largest differences: Strehl {worst[0]:.2f} %, distortion {worst[1]:.4f}, vignetting "
          f"{worst[2]:.2f}{'' if fits else '   OUT OF TOLERANCE'}")
    return fits


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("lenses", nargs="*", choices=[*LENSES, []], help="all by default")
    parser.add_argument("--save", type=Path, help="folder for the maps, as HDF5")
    given = parser.parse_args()
    warnings.simplefilter("ignore")  # of Numba, as it compiles optiland
    chosen = given.lenses or list(LENSES)
    fits = [compare(LENSES[name], given.save) for name in chosen]
    sys.exit(0 if all(fits) else 1)
