"""Figure 5.5: moving beads, found in the volumes of a series and tracked."""

import microscope as lfm
import numpy as np
from common import begin, number

from clplen import PointSources, Projector, deconvolve, point_images
from clplen.microscopy import find_points, match_points, track_points
from clplen.plot import orthogonal_views

COUNT, PHOTONS, BACKGROUND = 9, 3e5, 2.0  # lenslets, of a bead, of a pixel
START = np.array([(-12, -14, -22), (4, 12, -14), (14, -8, 12), (-8, 6, 24)]) * 1e-6  # x, y, z
STEPS = np.array([(2.4, 1.2, 1.5), (-1.5, -1.5, -1), (-1.8, 1.4, 1), (1.2, -2.2, -2)]) * 1e-6
RANDOM = 0.3e-6  # rms along an axis

run = begin(__doc__, __file__, quick="3 frames, 10 iterations")
cam = lfm.camera(run, count=COUNT)
z = np.linspace(-35e-6, 35e-6, 14)
images = point_images(cam, z, voxels_per_lenslet=3, cut=5e-3)
projector = Projector(images, (COUNT, COUNT), device=run.device)
side = np.arange(3 * COUNT) * images.side
first = (0, side[-1] / 2, side[-1] / 2)  # the axis lies in the middle
rng = np.random.default_rng(4)
at, paths, found, volumes = START.copy(), [], [], []
for _ in range(3 if run.quick else 8):
    paths.append(at[:, ::-1] + first)
    light = cam.expose(PointSources(at, power=PHOTONS)).to_numpy()
    counts = rng.poisson(np.maximum(light, 0) + BACKGROUND)
    volume = deconvolve(counts, projector, background=BACKGROUND, accelerate=True,
                        iterations=10 if run.quick else 20).volume
    volumes.append(volume)
    found.append(find_points(volume, axes=(z, side, side), size=(0.8, 0.7), snr=40))
    at = at + STEPS + rng.normal(0, RANDOM, at.shape)
tracks = track_points(found, step=(8e-6, 5e-6, 5e-6), gaps=1, unit="m")
print(f"  {tracks}")
near = [match_points(tracks.positions[tracks.frames == t], path, tolerance=(8e-6, 4e-6, 4e-6))
        for t, path in enumerate(paths)]
owner = np.full(len(tracks.ids), -1)
for t, pairs in enumerate(near):
    owner[np.flatnonzero(tracks.frames == t)[pairs[:, 0]]] = pairs[:, 1]
linked = np.diff(tracks.ids) == 0
right = linked & (np.diff(owner) == 0) & (owner[1:] >= 0)
off = tracks.positions[owner >= 0] - np.array(paths)[tracks.frames, owner][owner >= 0]
rms = np.sqrt((off**2).mean(axis=0)) * 1e6
number("right links of those there are", right.sum() / (len(START) * (len(paths) - 1)), 1, 0.05)
number("wrong links", np.count_nonzero(linked & ~right), 0, 0, ".0f")
number("error of places across, rms / um", float(np.hypot(*rms[1:])), 0, 0.4)
number("error of z, rms / um", float(rms[0]), 0, 1)
figure = orthogonal_views(np.max(volumes, axis=0), voxel=(z[1] - z[0], images.side, images.side),
                          scale="root", tracks=tracks, frame=len(paths) - 1, origin=z[0],
                          title="largest over time and along z, y, x; tracks, and the last places")
run.save(figure)
