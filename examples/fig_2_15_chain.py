"""Figure 2.15: the 2f system as a chain: the field of a point behind each part in turn."""

import numpy as np
from closed import LAM
from common import RED, begin, number
from drawing import LIGHT, new_figure
from two_f import EXTENT, GRID, PEAK, PITCH, D, F, N, Z, point

from clplen.wave import imaging_system

ROW, COLUMN, MM = 60, -110, 1e3  # samples from the axis to the point: up, and to the left
HALF, SMALL = (1.3, 2.3, 2.3, 1.3), (0.035, 1, 1, 0.15)  # half widths / mm
NAMES = "a point", "in front of the lens", "behind the lens", "image (log)"



def radius(u: np.ndarray) -> float:
    """Radius of a wave (positive: diverging): its phase steps along x grow by k dx^2/R."""
    middle = slice(N // 2 - 150, N // 2 + 150)
    steps = np.angle(u[middle, 1:] * u[middle, :-1].conj()).mean(axis=0)
    return 2 * np.pi * PITCH / (LAM * np.polyfit(GRID.x[middle], steps[middle], 1)[0])


run = begin(__doc__, __file__)
start, system = point(ROW, COLUMN, run.device), imaging_system(F, diameter=D)
print(system)
trace = [(0.0, None, start), *system.trace(start)]
fields = [field.to_numpy().astype(complex) for _, _, field in trace]
size = [np.abs(u) for u in fields]
number("in front of the lens: radius / mm", radius(fields[1]) * MM, 240.0, 0.01)
number("behind the lens: radius / mm", radius(fields[2]) * MM, -240.0, 0.01)
mean = size[2].sum() * PITCH**2 / (np.pi * D**2 / 4) * LAM * Z
number("behind the lens: mean amplitude times lam z1", mean, 1.0, 1e-3)
number("image: amplitude / (pi D^2/(4 lam^2 z1 z2))", size[3].max() / PEAK, 1.0, 1e-3)
number("image: x / mm", GRID.x[size[3].max(axis=0).argmax()] * MM, -COLUMN * PITCH * MM, 1e-9)
number("image: y / mm", GRID.y[size[3].max(axis=1).argmax()] * MM, -ROW * PITCH * MM, 1e-9)

figure = new_figure(11.6, 5.8)
panels = figure.subplots(2, 4)
for k, ((above, below), (z, part, _)) in enumerate(zip(panels.T, trace, strict=True)):
    intensity, label = (size[k] / size[k].max()).clip(1e-4) ** 2, "" if k else "y / mm"
    for axes in (above,) if k else (above, below):
        axes.imshow(intensity, extent=EXTENT, origin="lower", cmap=LIGHT,
                    norm="log" if k == 3 else "linear", vmin=1e-7, vmax=1)
    if k:
        below.imshow(np.angle(fields[k]), extent=EXTENT, origin="lower", cmap="twilight",
                     interpolation="nearest" if k == 3 else "hanning", interpolation_stage="rgba")
        text = f"{part.label}\n{part.describe()}".replace(", ", "\n")
        above.annotate(text, (-0.27, 0.97), xycoords="axes fraction", ha="center", va="top", size=7)
        above.annotate("", (-0.09, 0.6), (-0.47, 0.6), xycoords="axes fraction",
                       arrowprops={"arrowstyle": "-|>", "color": RED})
    x, y = np.array((COLUMN, ROW)) * PITCH * MM * (1, 0, 0, -1)[k]  # the middle below
    above.plot(x, y, "o", mfc="none", mec="w", ms=14 if x else 0)
    above.set(xlim=(-HALF[k], HALF[k]), ylim=(-HALF[k], HALF[k]), xticks=(-1, 0, 1), ylabel=label,
              yticks=(-1, 0, 1), title=f"{NAMES[k]}: z = {z * MM:g} mm")
    below.set(xlim=(x - SMALL[k], x + SMALL[k]), ylim=(y - SMALL[k], y + SMALL[k]),
              xlabel="x / mm", ylabel=label, title="phase" if k else "its one sample of 6.6 µm")
run.save(figure)
