"""Figure 2.9: signal-to-noise ratio against distance, behind a slit half as wide as the window."""

import warnings

import numpy as np
from closed import SETUP_A, S, exact_slit, slit, snr_db
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import new_figure

from clplen import SamplingWarning, propagate

TABLE = {  # dB at the distances of SHOWN: an independent float64 implementation
    "AS, no padding": (33.95, 36.53, 37.23, 33.83, 28.87, 24.78, 21.25, 17.99, 11.94, 6.59),
    "AS": (33.95, 36.53, 39.25, 46.82, 45.23, 35.23, 30.13, 26.22, 19.43, 12.67),
    "band-limited AS": (33.95, 36.53, 39.25, 46.82, 55.91, 61.13, 56.81, 50.76, 38.84, 27.42),
    "corrected, guard 0": (33.95, 36.53, 39.25, 46.54, 51.04, 49.37, 45.14, 40.92, 32.58, 16.38),
    "corrected": (33.95, 36.53, 39.25, 46.82, 56.05, 65.14, 74.20, 83.25, 101.52, 120.94),
    "RS convolution": (4.9, 3.9, 36.6, 46.82, 56.05, 65.14, 74.20, 83.25, 101.52, 120.94),
    "auto": (33.95, 36.53, 39.25, 46.82, 56.05, 65.14, 74.20, 83.25, 101.52, 120.94),
}
SHOWN = (0.1, 1, 2, 4, 8, 16, 32, 64, 256, 1024)  # z/S
METHODS = {  # options of propagate; colour and width of the line, size of the marker
    "auto": ({}, "0.85", 7, 0),
    "RS convolution": ({"method": "rs"}, GREEN, 3, 7),
    "corrected": ({"method": "cblas"}, RED, 1, 4),
    "band-limited AS": ({"method": "blas"}, BLUE, 1, 4),
    "corrected, guard 0": ({"method": "cblas", "guard": 0, "support": S / 2}, ORANGE, 1, 4),
    "AS": ({"method": "as"}, "k", 1, 4),
    "AS, no padding": ({"method": "as", "pad": 1}, "0.55", 1, 4),
}

run = begin(__doc__, __file__)
warnings.simplefilter("ignore", SamplingWarning)  # aliasing is what is shown
field = slit(SETUP_A, S / 2, run.device)
between = [] if run.quick else np.geomspace(0.1, 1024, 321)
places = np.unique(np.concatenate([SHOWN, between]))
exact = [exact_slit(SETUP_A.x, z * S, width=S / 2) for z in places]
figure = new_figure(9, 6.2)
axes = figure.subplots()
for name, (options, colour, width, size) in METHODS.items():
    fields = [propagate(field, z * S, **options).to_numpy()[0] for z in places]
    found = np.array([snr_db(e, u) for e, u in zip(exact, fields, strict=True)])
    axes.semilogx(places, found, color=colour, lw=width, label=name)
    axes.plot(SHOWN, TABLE[name], "o", color=colour, ms=size)
    for z, decibels in zip(SHOWN, TABLE[name], strict=True):
        number(f"{name}: z = {z:g} S / dB", found[places == z][0], decibels, 0.5, ".2f")
axes.text(20, 84, "what the sampled edge\nof the slit allows", ha="right")
axes.text(900, 58, "tops: the band ends on a zero\nof the slit's spectrum;\ndips: on a maximum",
          ha="right")
axes.text(0.13, 12, "kernel aliased")
axes.text(8, 4, "transfer function aliased\nor light wrapped around")
axes.set(xlabel="z / S", ylabel="SNR / dB", xlim=(0.09, 1150), ylim=(0, 130),
         title="S = 1024 samples of 2λ, slit S/2, 550 nm; dots: independent float64 values")
metres = axes.secondary_xaxis("top", functions=(lambda a: a * S * 1e3, lambda b: b / S / 1e3))
metres.set_xlabel("z / mm")
axes.grid(color="0.93", lw=0.6)
axes.legend(loc="upper left")
run.save(figure)
