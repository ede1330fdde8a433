"""Figure 2.16: the image of a point by each method of propagation, beside Airy's pattern."""

import numpy as np
from closed import snr_db
from common import begin, number
from drawing import LIGHT, bar, new_figure
from scipy.signal import resample
from two_f import EXTENT, GRID, METHODS, PEAK, PITCH, N, airy_image, image

TABLE = {  # SNR / dB: window, r < 0.5 mm; peak: by independent float64; colour of what is drawn
    "multi-step, pad 1": (0.51, 0.51, 5.37067, "C0--"),
    "multi-step, pad 2": (51.13, 80.02, 1, "C0"), "AS, pad 1": (0.51, 0.51, 4.57883, "C1--"),
    "AS, pad 2": (41.61, 61.57, 0.99981, "C1"), "BLAS, pad 1": (25.10, 56.24, 1.00013, "C2--"),
    "BLAS, pad 2": (52.17, 63.42, 0.99985, ""), "corrected BLAS": (52.67, 63.58, 0.99989, ""),
    "auto": (52.67, 63.58, 0.99989, "k"), "Fresnel IR, pad 2": (56.25, 83.27, 1, "C4")}
SHOWN, TICKS = (-0.5, 0.5), (-0.4, 0, 0.4)  # mm


def mean_at_radius(values: np.ndarray) -> np.ndarray:
    """Mean over rings one sample wide, as far as the window goes."""
    return (np.bincount(ring, values.ravel()) / np.bincount(ring))[: N // 2]


run = begin(__doc__, __file__)
airy, r = airy_image(), np.hypot(GRID.y[:, None], GRID.x)
core, ring = r < 0.5e-3, np.rint(r / PITCH).astype(int).ravel()
far, x = np.arange(N // 2) * PITCH * 1e3, (np.arange(8 * N) / 8 - N // 2) * PITCH * 1e3
figure = new_figure(10.6, 8.2)
upper, lower = figure.subfigures(2, 1, height_ratios=[1.3, 1])
images, (cut, off) = upper.subplots(2, 5, sharex=True, sharey=True), lower.subplots(1, 2)
for axes, name in zip(images.flat, ("Airy", *METHODS), strict=True):
    u = image(name, run.device) if name in METHODS else airy
    intensity = np.abs(u / PEAK) ** 2
    drawn = axes.imshow(intensity.clip(1e-9), cmap=LIGHT, norm="log", vmin=1e-7, vmax=1,
                        extent=EXTENT, origin="lower")
    axes.set(xlim=SHOWN, ylim=SHOWN, xticks=TICKS, title=name, xlabel="x / mm", ylabel="y / mm")
    axes.label_outer()
    row = np.abs(resample(u[N // 2], 8 * N) / PEAK) ** 2  # eight values a sample
    if name == "Airy":
        cut.semilogy(x, row, color="0.8", lw=5, label="Airy")
        off.semilogy(far, mean_at_radius(intensity), color="0.8", label="Airy itself")
        continue
    full, inner, peak, style = TABLE[name]
    number(f"{name}: SNR / dB", snr_db(airy, u), full, 0.05, ".2f")
    number(f"{name}: SNR for r < 0.5 mm / dB", snr_db(airy[core], u[core]), inner, 0.2, ".2f")
    number(f"{name}: peak / Airy", intensity[N // 2, N // 2], peak, 5e-5, ".5f")
    if style in ("C0--", "C1--", "k"):
        cut.semilogy(x, row, style, lw=1, label=name)
    if style:
        off.semilogy(far, mean_at_radius(np.abs((u - airy) / PEAK) ** 2), style, lw=1, label=name)
bar(upper, drawn, images, "intensity / Airy's peak", extend="both")
cut.set(xlim=(-0.25, 0.25), ylim=(1e-7, 20), xlabel="x / mm", ylabel="intensity / Airy's peak",
        title="cut through the middle; the other six: as auto")
off.set(xlim=(0, 3.3), ylim=(1e-13, 1e6), xlabel="r / mm", ylabel="mean over a ring / Airy's peak",
        title="|u - Airy|$^2$; corrected BLAS: as auto; BLAS, pad 2: within 5 dB of it")
cut.legend(loc="upper right")
off.legend(ncols=3, loc="upper right")
run.save(figure)
