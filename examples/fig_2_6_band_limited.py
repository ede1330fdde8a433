"""Figure 2.6: the stages of the band-limited angular spectrum, U(0), A, H, A H, U(z)."""

import numpy as np
from closed import LAM
from common import begin, number
from stages import draw, inner, stages, star

from clplen import propagate

Z = 12e-3

run = begin(__doc__, __file__)
field = star(run.device)
found = stages(field, Z, "blas")
W, limit = found.window.extent[1], found.plan.report.band[1]
number("limit / (1/mm)", limit / 1e3, 1e-3 * np.sin(np.arctan(W / 2 / Z)) / LAM, 1e-3, ".3f")
energy, A = found.plan.energy(field), np.abs(found.arrays["A"]) ** 2
f = np.abs(np.fft.fftshift(found.window.fx)) > limit
beyond = A[f].sum() + A[~f][:, f].sum()
cut, closed = energy.cut / energy.into, beyond / A.sum()
number("power beyond the limit / power at 0", cut, closed, 1e-5, ".5f")
asked = propagate(field, Z, method="blas").to_numpy()
chain = found.arrays["U(z)"][inner(found.window, field.grid)]
number("propagate less the stages by NumPy", np.abs(asked - chain).max(), 0, 1e-5, ".5f")
names = {"U(0)": "U(x, y; 0)", "A": "A = FFT of U(0)", "H": "H, z = 12 mm", "A H": "A H",
         "U(z)": "U(x, y; z): inverse FFT"}
run.save(draw(found, names, limit / 500))
