"""Two light-field microscopes with one objective: figure 7.1.

20x/0.5 in air, 525 nm, a field of 69 um, 275 x 275 pixels, voxels of 1.25 um. One has 11 x 11
lenslets of 125 um on the native image, the other 5 x 5 lenslets of 1 mm on the conjugate pupil.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from common import Run
from matplotlib.axes import Axes

from clplen import MicrolensArray, PlenopticCamera, Projector, point_images
from clplen.microscopy import FourierProjector, fourier_point_images

OBJECTIVE = {"magnification": 20, "na": 0.5, "wavelength": 525e-9}
ACROSS = 55  # voxels


def projectors(run: Run, z: Any) -> dict[str, Any]:
    """Of both microscopes, by name."""
    on_image = PlenopticCamera.microscope(
        **OBJECTIVE, pixels_per_lenslet=25, device=run.device,
        mla=MicrolensArray(125e-6, 2.5e-3, count=9, fill="full"))
    on_pupil = PlenopticCamera.fourier_microscope(
        **OBJECTIVE, relay=0.1, pixel_pitch=18e-6, shape=(275, 275), device=run.device,
        mla=MicrolensArray(1e-3, 72e-3, count=5, fill="full"))
    return {
        "lenslets on the image": Projector(point_images(on_image, z, cut=5e-3), (11, 11),
                                           device=run.device),
        "lenslets on the pupil": FourierProjector(fourier_point_images(on_pupil, z),
                                                  (ACROSS, ACROSS), device=run.device),
    }


def filaments(z: Any, side: float, count: int = 5) -> np.ndarray:
    """Straight lines of 50 um in any direction, 1.2 um (rms) thick, 2.5 um along z."""
    t = (np.arange(ACROSS) - (ACROSS - 1) / 2) * side * 1e6
    z, y, x = z[:, None, None] * 1e6, t[:, None], t
    volume, rng = np.zeros((len(z), ACROSS, ACROSS)), np.random.default_rng(3)
    for _ in range(count):
        centre, along = (rng.random(3) - 0.5) * (30, 20, 20), rng.normal(size=3)
        for step in np.linspace(-25, 25, 100):
            cz, cy, cx = centre + step * along / np.linalg.norm(along)
            across = ((z - cz) / 2.5) ** 2 + ((y - cy) / 1.2) ** 2 + ((x - cx) / 1.2) ** 2
            volume += np.exp(-0.5 * across)
    return volume


def error(found: Any, true: Any) -> float:
    """Energy of the difference over that of the truth, square root."""
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def draw(panel: Axes, picture: Any, largest: float, words: str) -> None:
    """A picture, square root of its values."""
    panel.imshow(np.sqrt(np.clip(picture / largest, 0, 1)), cmap="inferno", aspect="auto")
    panel.set(xticks=[], yticks=[])
    panel.set_title(words, fontsize=9)
