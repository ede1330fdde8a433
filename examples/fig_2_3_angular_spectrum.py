"""Figure 2.3: the stages of the angular spectrum of plane waves, U(0), A, H, A H, U(z)."""

import numpy as np
from closed import LAM, exact_slit, slit, snr_db
from common import begin, number
from stages import draw, stages, star

from clplen import Field, Grid, propagate

Z, STEP = 3e-3, 4e-6
EVANESCENT = {0.05: 37.3, 0.2: 41.9, 0.5: 44.0, 1: 44.2}  # z/lam: SNR in dB, slit of 2 lam
GAUSSIAN = {0: 0.56499 - 0.49480j, 8: 0.41656 - 0.09524j}  # sample: U, waist 2 um, z = 20 um

run = begin(__doc__, __file__)
field = star(run.device)
found = stages(field, Z, "as")
sine = LAM / (2 * STEP)
number("H is sampled up to z / mm", found.plan.report.fully_sampled_to * 1e3,
       field.grid.extent[1] * np.sqrt(1 / sine**2 - 1) * 1e3, 1e-4)
energy = found.plan.energy(field)
number("power at z / power at 0", (energy.window + energy.outside) / energy.into, 1, 1e-5)
back = propagate(propagate(field, Z, method="as", pad=1), -Z, method="as", pad=1).to_numpy()
number("there and back: largest difference", np.abs(back - field.to_numpy()).max(), 0, 1e-5)
grid = Grid((256, 256), 0.25e-6)
waist = np.exp(-(grid.x**2 + grid.y[:, None] ** 2) / 2e-6**2)
beam = Field.from_array(waist, grid, wavelength=LAM, device=run.device)
row = propagate(beam, 20e-6, method="as", pad=1).to_numpy()[128, 128:]
for place, u in GAUSSIAN.items():
    number(f"Gaussian beam, r = {place / 4:g} um: Re U", row[place].real, u.real, 1e-4)
    number(f"Gaussian beam, r = {place / 4:g} um: Im U", row[place].imag, u.imag, 1e-4)
fine = Grid((1, 1024), LAM / 8)
narrow = slit(fine, 2 * LAM, run.device)
for times, decibels in EVANESCENT.items():
    u = propagate(narrow, times * LAM, method="as", pad=1).to_numpy()[0]
    exact = exact_slit(fine.x, times * LAM, width=2 * LAM)
    number(f"slit of 2 lam, z = {times} lam: SNR / dB", snr_db(exact, u), decibels, 0.5, ".1f")
names = {"U(0)": "U(x, y; 0)", "A": "A = FFT of U(0)", "H": "H, z = 3 mm", "A H": "A H",
         "U(z)": "U(x, y; z): inverse FFT"}
run.save(draw(found, names, 0))
