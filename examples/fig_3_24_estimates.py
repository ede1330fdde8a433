"""Figure 3.24: estimated alphas on the curve alpha(dz)."""

from common import mm, number, start

from clplen import demo, plot

example = start(__doc__, __file__)
camera = example.camera
found = [demo.estimates(camera, dz) for dz in demo.DEPTHS]
for dz, methods in zip(demo.DEPTHS, found, strict=True):
    number(f"method 'compensated', alpha at {mm(dz)}", methods["compensated"].alpha,
           camera.alpha(dz), 0.01)

estimates = {"the thesis' own": list(zip(demo.DEPTHS, demo.THESIS_ALPHAS, strict=True))}
for method in demo.METHODS:
    alphas = [methods[method].alpha for methods in found]
    estimates[f"method '{method}'"] = list(zip(demo.DEPTHS, alphas, strict=True))
example.save(plot.alpha_curve(camera, estimates, reach=0.06))
