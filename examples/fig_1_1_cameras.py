"""Figure 1.1: a traditional and a computational camera before three letters."""

import numpy as np
import rays
from common import BLUE, GREEN, RED, begin, mm, number, pixels
from drawing import new_figure
from extended import like, show
from letters import covered, scene

from clplen import LightField, MicrolensArray, PlenopticCamera, refocus

SIZE, COUNT, P = 24, 61, 0.15  # of the font and of the array in lenslets, pitch in mm
LETTERS = {"N": (-50e-3, (19, 19), SIZE), "O": (0.0, (0, 0), SIZE), "F": (50e-3, (-19, -19), SIZE)}
COLOURS = dict(zip(LETTERS, (BLUE, GREEN, RED), strict=True))

run = begin(__doc__, __file__)
array = MicrolensArray(P * 1e-3, 10e-3, count=COUNT, fill="full")
cam = PlenopticCamera.type1(focal_length=0.12, mla=array, wavelength=532e-9, pixels_per_lenslet=20,
                            device=run.device)
raw = cam.expose(scene(cam, LETTERS), model="rays")
lf = LightField.from_raw(raw)
pictures = {c: pixels(refocus(lf, alpha=cam.alpha(dz))) for c, (dz, _, _) in LETTERS.items()}
at = np.arange(COUNT) - COUNT // 2
for letter, (dz, place, size) in LETTERS.items():
    part = (np.abs(at - place[0]) < 10)[:, None] * (np.abs(at - place[1]) < 10)
    number(f"{letter}, dz = {mm(dz)}: refocused, like its outline",
           like(pictures[letter][part], covered(letter, place, size, at)[part]), 1, 0.05)

figure = new_figure(12, 6)
panels = figure.subplot_mosaic("aabbttt;ccddNOF", width_ratios=[1, 1, 0.6, 0.6, 1, 1, 1])
for name, lenslets in (("a", False), ("c", True)):
    rays.stage(panels[name], (-315, 275), (-6.2, 6.2),
               "a computational camera" if lenslets else "a traditional camera")
    rays.draw_camera(panels[name], cam, pixels=False, lenslets=lenslets)
    for letter, (dz, (_, place), _) in LETTERS.items():
        z = cam.object_distance + dz
        x, u = -place * P * z / cam.image_distance, np.linspace(-1, 1, 3) * cam.aperture_diameter
        rays.draw_rays(panels[name], cam, (x * 1e-3, dz), u * 0.499, COLOURS[letter], lw=0.8,
                       lenslets=lenslets)
        panels[name].text(-z * 1e3, x, letter, color=COLOURS[letter], size=13, weight="bold",
                          ha="center", va="center", zorder=7)
show(panels["b"], pictures["O"], P * 1e-3)
panels["b"].set_title("its sensor records the picture")
show(panels["d"], raw.to_numpy(), cam.pixel_pitch)
panels["d"].set_title("its sensor records rays")
panels["t"].set_axis_off()
panels["t"].text(0.03, 0.5, "There is one picture:\nfocus, aperture and viewpoint\n"
                 "are those of the exposure.", va="center", size=10)
for letter, colour in COLOURS.items():
    show(panels[letter], pictures[letter], P * 1e-3)
    panels[letter].set_title(f"computed: focus on {letter}", color=colour)
    panels[letter].set(xlabel="", ylabel="", xticks=[], yticks=[])
rays.say_scale(figure, panels["a"], "pictures turned by 180 degrees", where="left:")
run.save(figure)
