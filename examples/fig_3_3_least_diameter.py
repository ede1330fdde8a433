"""Figure 3.3: the least diameter of a lenslet against its focal length, and measured crosstalk."""

from arrays import LAM, draw_least
from common import BLUE, ORANGE, RED, begin, number
from drawing import new_figure

from clplen import MicrolensArray, PlenopticCamera, PointSources
from clplen.analysis import crosstalk
from clplen.cameras import Plenoptic1

F_MU, COUNT = 10e-3, 51
WIDTHS = (50, 70, 90, 100, 113.9, 135, 150, 175, 200, 250, 300)  # d in um
OUTSIDE = {  # of a point's own cell, by an independent float64 simulation
    "full": (.860, .514, .186, .185, .208, .096, .107, .061, .047, .031, .025),
    "circular": (.878, .632, .240, .180, .166, .088, .086, .050, .038, .024, .020),
}
QUICK = {70, 150}


def camera(d: float, fill: str = "full", *, f_mu: float = F_MU, pixels: int = 30) -> Plenoptic1:
    """F = 240 mm and the matched aperture."""
    array = MicrolensArray(d, f_mu, count=COUNT, fill=fill)
    return PlenopticCamera.type1(focal_length=0.120, mla=array, wavelength=LAM,
                                 pixels_per_lenslet=pixels, device=run.device)


run = begin(__doc__, __file__, quick="three cameras, of coarser pixels")
for f_mu, reference in ((F_MU, 113.93), (5e-3, 80.56)):
    least = camera(150e-6, f_mu=f_mu).describe()["Airy limit"]
    number(f"least diameter for f_mu = {f_mu * 1e3:.0f} mm / um", least * 1e6, reference, 0.01,
           ".2f")
figure = new_figure(10, 4.2)
left, right = figure.subplots(1, 2)
draw_least(left, F_MU)
for (fill, outside), colour, marker in zip(OUTSIDE.items(), (BLUE, ORANGE), "os", strict=True):
    name = "square" if fill == "full" else "round"
    for d, reference in zip(WIDTHS, outside, strict=True):
        if not run.quick or d in QUICK:
            pixels = 16 if run.quick else 24 if d < 180 else 40  # wide lenslets bend light more
            raw = camera(d * 1e-6, fill, pixels=pixels).expose(PointSources((0, 0, 0)))
            found = crosstalk(raw.to_numpy(), raw.cells)
            number(f"outside the own cell, {name}, d = {d} um", found, reference, 0.01, ".3f")
            right.plot(d, found, marker, color=colour, ms=5)
    right.plot(WIDTHS, outside, "-", color=colour, lw=1, label=f"{name} lenslets")
right.axvline(113.93, color=RED, lw=1, ls="--")
right.text(116, 0.8, "least diameter", color=RED)
right.set(xlabel=r"diameter d = p / um ($f_\mu$ = 10 mm, matched aperture)", ylim=(0, 0.92),
          ylabel="share of an in-focus point's light outside its cell")
right.legend(loc="center right", title="lines: reference, marks: measured")
run.save(figure)
