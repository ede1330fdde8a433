"""Figure 7.1: filaments through a conventional and a Fourier light-field microscope."""

import fourier_microscope as two
import numpy as np
from common import begin, number
from drawing import new_figure

from clplen import deconvolve

PHOTONS = 2e6  # in the pupil
ERRORS = {"lenslets on the image": 0.45, "lenslets on the pupil": 0.23}
NATIVE = {"lenslets on the image": 0.625, "lenslets on the pupil": 0.184}

run = begin(__doc__, __file__, quick="3 planes, 5 iterations")
z = np.array([-20, 0, 20]) * 1e-6 if run.quick else np.arange(-30, 31, 5) * 1e-6
iterations, native = 5 if run.quick else 30, len(z) // 2
both = two.projectors(run, z)
side = both["lenslets on the pupil"].images.side
true = two.filaments(z, side)
true *= PHOTONS / true.sum()
frames, found = {}, {}
for name, projector in both.items():
    means = projector.forward(true).astype(float)
    frames[name] = np.random.default_rng(0).poisson(means)
    found[name] = deconvolve(frames[name], projector, iterations=iterations).volume
    if not run.quick:
        number(f"{name}: error", two.error(found[name], true), ERRORS[name], 0.02, ".3f")
        of_plane = two.error(found[name][native], true[native])
        number(f"{name}: error at z = 0", of_plane, NATIVE[name], 0.03, ".3f")
    print(f"  {name}: light on the sensor {means.sum() / PHOTONS:.3f} of the pupil's")

figure = new_figure(11, 7.4)
panels = figure.subplots(3, 4)
volumes = {"truth": true, **found}
for row, (name, volume) in zip(panels, volumes.items(), strict=True):
    if name in frames:
        two.draw(row[0], frames[name], np.quantile(frames[name], 0.999), f"{name}: frame")
    for panel, picture, words in zip(
            row[1:], (volume.max(axis=0), volume[native], volume.max(axis=1)),
            ("largest along z", "z = 0", "z and x, largest along y"), strict=True):
        largest = {"z = 0": true[native].max()}.get(words, true.max())
        two.draw(panel, picture, largest, f"{name}, {words}" if name == "truth" else words)
panels[0, 0].axis("off")
figure.supxlabel("square root of the light over the truth's largest; 69 um across, "
                 f"z from {z[0] * 1e6:.0f} to {z[-1] * 1e6:.0f} um")
run.save(figure)
