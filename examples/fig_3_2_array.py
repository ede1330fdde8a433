"""Figure 3.2: the parameters of a lenslet array: pitch p, diameter d, number N, width W."""

import numpy as np
from arrays import LAM, draw_lenslets, draw_whole
from common import begin, number
from drawing import bar, new_figure

from clplen import Field, Grid, MicrolensArray

P, F_MU, N = 150e-6, 10e-3, 101
SHOWN = 4  # lenslets across in the lower row
KINDS = {  # lattice, fill, diameter: the share of the array that is open
    "square lattice, square lenslets, d = p": ("square", "full", P, 1.0),
    "square lattice, round lenslets, d = p": ("square", "circular", P, np.pi / 4),
    "hexagonal lattice, round, d = 0.9 p": ("hexagonal", "circular", 0.9 * P,
                                            0.81 * np.pi / (2 * np.sqrt(3))),
}


run = begin(__doc__, __file__)
whole = MicrolensArray(P, F_MU, count=N, fill="full")
number("width W / mm", whole.extent[1] * 1e3, 15.15, 1e-6)
figure = new_figure(11, 3.7)
left, right = figure.subfigures(1, 2, width_ratios=[1, 2.3])
draw_whole(left.subplots(), whole)
panels = right.subplots(1, len(KINDS), sharey=True)
for axes, (name, (lattice, fill, d, share)) in zip(panels, KINDS.items(), strict=True):
    array = MicrolensArray(P, F_MU, count=12, lattice=lattice, fill=fill, diameter=d)
    grid = Grid((400, 400), (SHOWN * array.row_pitch / 400, SHOWN * P / 400))
    plane = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=run.device)
    behind = array.apply(plane).to_numpy()
    number(f"{name}: open", np.mean(np.abs(behind)), share, 2e-3)
    drawn = draw_lenslets(axes, array, behind, grid)
    axes.set_title(name.replace(", ", "\n", 1))
panels[0].set_ylabel("y / mm")
bar(right, drawn, list(panels), "phase of a lenslet / rad; grey: opaque")
run.save(figure)
