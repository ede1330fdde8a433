"""Figure 7.2: aberrations of an objective from one frame of beads; a volume without and with."""

import numpy as np
import pupils as aid
from common import begin, number
from drawing import bar, new_figure

from clplen import PointSources, Projector, deconvolve, point_images
from clplen.microscopy import fit_pupil

PUT_IN = {6: 60e-9, 7: -50e-9, 8: 40e-9, 10: 40e-9, 11: -60e-9}  # Noll's index: metres, rms
BEADS = np.array([(-20, -17, 50), (18, -19, -45), (-16, 20, -55), (17, 16, 60)]) * 1e-6
PERFECT, FOUND, REAL = "a perfect pupil", "the pupil found", "the pupil put in"
PHOTONS, HAZE = 1e6, 0.25  # of the helix in all; of the beads' frame a pixel

run = begin(__doc__, __file__, quick="2 beads, 5 planes, 3 x 3 voxels a lenslet, 5 iterations")
perfect, real = aid.camera(run), aid.camera(run, PUT_IN)
rng, beads = np.random.default_rng(2), BEADS[: 2 if run.quick else 4]
mean = real.expose(PointSources(beads, power=np.linspace(4e4, 6e4, len(beads)))).to_numpy()
frame = rng.poisson(mean + HAZE)
about = beads + rng.normal(size=beads.shape) * 1e-6
terms = tuple(PUT_IN) if run.quick else range(5, 12)
found = fit_pupil(frame, perfect, beads=about, terms=terms)
off = found.coefficients - [PUT_IN.get(j, 0) for j in terms]
number("found - put in, nm rms", np.linalg.norm(off) * 1e9, 0, 1, ".1f")
number("chi2 of the beads' frame", found.chi2, 1, 0.1, ".2f")

v, z = (3, np.linspace(-40, 40, 5) * 1e-6) if run.quick else (5, np.linspace(-64, 64, 17) * 1e-6)
models = {name: Projector(point_images(camera, z, voxels_per_lenslet=v, cut=5e-3),
                          (aid.COUNT, aid.COUNT), device=run.device)
          for name, camera in ((PERFECT, perfect), (FOUND, aid.camera(run, found.pupil)),
                               (REAL, real))}
behind = models[REAL]
true = aid.helix(z, behind.volume_shape)
true *= PHOTONS / behind.forward(true).sum()
mean = behind.forward(true).astype(float)
seen = rng.poisson(mean)
volumes = {name: deconvolve(seen, model, iterations=5 if run.quick else 40)
           for name, model in models.items()}
error = {name: np.linalg.norm(one.volume - true) / np.linalg.norm(true)
         for name, one in volumes.items()}
if not run.quick:
    number(f"error of the volume with {FOUND}", error[FOUND], error[REAL], 0.01, ".3f")
print(f"  error of the volume with {PERFECT} {error[PERFECT]:.3f}")

figure = new_figure(13, 6.2)
panels = figure.subplots(2, 4)
panels[0, 0].imshow(np.sqrt(frame), cmap="inferno")
panels[0, 0].set(xticks=[], yticks=[], title=f"{len(beads)} beads, one frame")
shown = aid.draw_pupils(panels[0, 1:3], (real.pupil, found.pupil), ("put in", "found"))
bar(figure, shown, list(panels[0, 1:3]), "path / nm")
aid.draw_terms(panels[0, 3], found, PUT_IN)
aid.draw_section(panels[1, 0], true / true.max(), z, "truth")
for panel, name in zip(panels[1, 1:3], (PERFECT, FOUND), strict=True):
    words = f"with {name}: error {error[name]:.2f}"
    aid.draw_section(panel, volumes[name].volume / true.max(), z, words)
aid.draw_residuals(panels[1, 3], volumes, mean)
figure.supxlabel("helix: largest along y, square root of light over the truth's largest")
run.save(figure)
