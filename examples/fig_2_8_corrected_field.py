"""Figure 2.8: field of the band-limited and the corrected band-limited angular spectrum."""

import warnings

import numpy as np
from closed import SETUP_A, S, exact_slit, fitted, slit, snr_db
from common import BLUE, ORANGE, RED, begin, number
from drawing import new_figure

from clplen import SamplingWarning, propagate

Z = 64 * S
WAYS = {  # options of propagate, SNR in dB, colour
    "angular spectrum": ({"method": "as"}, 26.22, "0.6"),
    "corrected, guard 0": ({"method": "cblas", "guard": 0, "support": S / 2}, 40.92, ORANGE),
    "band-limited": ({"method": "blas"}, 50.76, BLUE),
    "corrected": ({"method": "cblas"}, 83.25, RED),
}

run = begin(__doc__, __file__)
warnings.simplefilter("ignore", SamplingWarning)  # for the angular spectrum, which is aliased
field = slit(SETUP_A, S / 2, run.device)
exact, x = exact_slit(SETUP_A.x, Z, width=S / 2), SETUP_A.x * 1e3
figure = new_figure(10, 7.4)
panels = figure.subplot_mosaic("ab;cc", width_ratios=[1.2, 1], height_ratios=[1, 1.15])
panels["a"].plot(x, np.abs(exact) ** 2, color="0.85", lw=6, label="exact, by quadrature")
panels["b"].plot(x, np.abs(exact) ** 2 * 1e3, color="0.85", lw=6)
for name, (options, reference, colour) in WAYS.items():
    found = fitted(exact, propagate(field, Z, **options).to_numpy()[0].astype(complex))
    decibels = snr_db(exact, found)
    number(f"{name}: SNR / dB", decibels, reference, 0.5, ".2f")
    if name not in ("angular spectrum", "corrected, guard 0"):
        panels["a"].plot(x, np.abs(found) ** 2, color=colour, lw=1, label=name)
        panels["b"].plot(x, np.abs(found) ** 2 * 1e3, color=colour, lw=1)
    error = np.abs(found - exact)
    panels["c"].semilogy(x, error, color=colour, lw=0.9, label=f"{name}, {decibels:.2f} dB")
panels["a"].axvspan(-S * 250, S * 250, color="0.95", zorder=0)
panels["a"].text(0, 0.06, "slit", ha="center")
panels["a"].set(xlabel="x / mm", ylabel="intensity", xlim=(-S * 500, S * 500), ylim=(0, 1.9),
                title="slit S/2 = 0.5632 mm, z = 64 S = 72.1 mm, 550 nm")
panels["a"].legend(loc="upper center", ncols=3)
panels["b"].set(xlabel="x / mm", ylabel="intensity / 0.001", xlim=(0.4, S * 500), ylim=(0, 60),
                title="the same at the edge of the window")
panels["c"].set(xlabel="x / mm", ylabel="error of the amplitude", xlim=(-S * 500, S * 500),
                ylim=(1e-7, 1))
panels["c"].grid(color="0.93", lw=0.6)
panels["c"].legend(loc="lower center", ncols=4)
run.save(figure)
