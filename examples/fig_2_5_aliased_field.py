"""Figure 2.5: the field behind a square with an aliased transfer function, and without."""

import warnings

import numpy as np
from closed import LAM, SETUP_A, S, exact_slit, fitted, slit, snr_db
from common import BLUE, GREEN, ORANGE, begin, number
from drawing import LIGHT, bar, new_figure

from clplen import Field, Grid, SamplingWarning, aperture, propagate

Z = 64 * S
WAYS = {  # options of propagate, SNR behind a slit in dB, colour
    "angular spectrum, periodic": ({"method": "as", "pad": 1}, 17.99, ORANGE),
    "angular spectrum, window of 2 S": ({"method": "as"}, 26.22, BLUE),
    "auto: nothing aliased": ({}, 83.25, GREEN),
}

run = begin(__doc__, __file__)
warnings.simplefilter("ignore", SamplingWarning)  # aliasing is what is shown
n = 256 if run.quick else 1024
grid, x = Grid((n, n), S / n), SETUP_A.x * 1e3
plane = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=run.device)
square, line = aperture(plane, S / 2, shape="square"), slit(SETUP_A, S / 2, run.device)
exact = exact_slit(SETUP_A.x, Z, width=S / 2)
figure = new_figure(10.5, 6.8)
panels = figure.subplot_mosaic("abc;ddd", height_ratios=[1.5, 1])
ends = np.array([-n / 2 - 0.5, n / 2 - 0.5]) * grid.pitch[1] * 1e3
for panel, (name, (options, reference, colour)) in zip("abc", WAYS.items(), strict=True):
    found = fitted(exact, propagate(line, Z, **options).to_numpy()[0].astype(complex))
    number(f"slit, {name}: SNR / dB", snr_db(exact, found), reference, 0.5, ".2f")
    panels["d"].semilogy(x, np.abs(found) ** 2, color=colour, lw=1.3,
                         label=f"{name}: {reference} dB")
    picture = propagate(square, Z, **options).intensity().to_numpy()
    drawn = panels[panel].imshow(picture, cmap=LIGHT, norm="log", vmin=1e-5, vmax=2,
                                 origin="lower", extent=(*ends, *ends))
    panels[panel].set(xlabel="x / mm", title=name)
panels["a"].set(ylabel="y / mm")
bar(figure, drawn, [panels[p] for p in "abc"], "intensity (logarithmic)", extend="both")
panels["d"].semilogy(x, np.abs(exact) ** 2, "k:", lw=1.3, label="exact")
panels["d"].set(xlim=(0, S * 500), ylim=(8e-4, 3), xlabel="x / mm", ylabel="intensity",
                title="slit S/2 = 0.5632 mm, z = 64 S = 72.1 mm, 550 nm; exact: by quadrature")
panels["d"].legend(ncols=2, loc="lower left")
run.save(figure)
