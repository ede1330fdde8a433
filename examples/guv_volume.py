"""From a raw frame of a light-field microscope to a volume: a giant vesicle is a hollow shell.

The white frame gives the lattice, with which the frame is rectified to 15 x 15 pixels a lenslet;
point images of the microscope and Richardson and Lucy's iteration give the volume; it is measured,
drawn and written as OME-TIFF. The same is done with the simulated frame of a sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shell
import vesicle
from common import BLUE, ORANGE, Run, begin
from drawing import LIGHT, new_figure
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm

from clplen import Projector, decode_raw, deconvolve, point_images, refocus
from clplen.cameras import Microscope
from clplen.io import write_volume
from clplen.microscopy import DeconvolutionResult

PIXELS, ITERATIONS, QUICK = 15, 20, 6
OTHERS: dict[str, dict[str, Any]] = {
    "accelerated": {"accelerate": True},
    "total variation": {"prior": "tv", "strength": 10.0},
}
WITHIN = (90, 60, 45)  # degrees from the plane of the largest ring
HALF = 23.0  # um that are drawn on either side
MOST = 99.9  # per cent of the voxels are no brighter than the largest colour
UM = 1e6


@dataclass(frozen=True)
class Bench:
    """What turns a frame into a volume."""

    seen: vesicle.Seen
    projector: Projector
    voxels: shell.Voxels
    iterations: int

    def volume(self, word: str, counts: Any = None, **options: Any) -> DeconvolutionResult:
        """The volume of the frame, or of other counts; its residual is printed."""
        counts = self.seen.counts if counts is None else counts
        most = self.iterations // 2 if options.get("accelerate") else self.iterations
        result = deconvolve(counts, self.projector, white=self.seen.white,
                            background=self.seen.haze, iterations=most, **options)
        rises = np.count_nonzero(np.diff(result.residuals) >= 0)
        print(f"  {word}: residual {result.residuals[0]:.3f} to {result.residuals[-1]:.4f} in "
              f"{result.iterations} iterations, {rises} of which raised it")
        return result

    def shell(self, result: DeconvolutionResult, within: float) -> shell.Shell:
        """The shell in a volume, by rays up to so many degrees from the equator."""
        start = shell.find_shell(result.volume, self.voxels, centre=(0, 0, 0), within=45,
                                 radius=vesicle.radius())
        return shell.find_shell(result.volume, self.voxels, centre=start.centre, within=within,
                                radius=float(start.radii[1:].mean()))

    def measured(self, word: str, result: DeconvolutionResult) -> shell.Shell:
        """The shell, its numbers printed."""
        for within in WITHIN:
            found = self.shell(result, within)
            print(f"  {word}, within {within} degrees: {radii(found)}, "
                  f"{found.spread * UM:.2f} um rms about them")
        inside, outside = shell.contrast(result.volume, self.voxels, found)
        z, y, x = found.centre * UM
        print(f"  {word}: centre (x, y, z) = ({x:.2f}, {y:.2f}, {z:.2f}) um; light inside "
              f"{inside:.3f} and outside {outside:.3f} of that of the shell")
        for normal, plane in ((0, "xy"), (1, "xz"), (2, "yz")):
            inside, _ = shell.contrast(result.volume, self.voxels, found, normal=normal)
            print(f"  {word}, {plane}: light inside {inside:.3f} of that of the ring")
        return found


def radii(found: shell.Shell) -> str:
    """In words."""
    z, y, x = found.radii * UM
    return f"radii along x, y, z {x:.2f}, {y:.2f}, {z:.2f} um"


def planes(quick: bool) -> np.ndarray:
    """z in metres, none of them the native plane; of the simulated, smaller vesicle nearer."""
    last, step = (24.5, 7.0) if vesicle.REAL else (10.5, 3.0)
    return np.arange(-last, last + 0.1, step if quick else 1.0) * 1e-6


def prepared(seen: vesicle.Seen, cam: Microscope, z: np.ndarray, v: int, iterations: int) -> Bench:
    """Point images of v x v voxels a lenslet for the lenslets of the frame."""
    images = point_images(cam, z, voxels_per_lenslet=v, cut=5e-3)
    rows, columns = (size // images.pixels for size in seen.counts.shape)
    projector = Projector(images, (rows, columns), device=cam.device)
    voxels = shell.Voxels(z, cam.mla.pitch / cam.magnification / v, projector.volume_shape)
    return Bench(seen, projector, voxels, iterations)


def compare(bench: Bench, plain: DeconvolutionResult) -> None:
    """What acceleration and a prior change."""
    results = {"plain": plain} | {word: bench.volume(word, **options)
                                  for word, options in OTHERS.items()}
    for word, result in results.items():
        found = bench.shell(result, WITHIN[-1])
        grain = shell.grain(result.volume, bench.voxels, found)
        print(f"  {word}: {radii(found)}; grain near the native plane {grain:.2f}")


def main() -> None:
    """Frame to volume, numbers, picture, file."""
    run = begin(__doc__, __file__, quick="8 planes, 2 x 2 voxels a lenslet, 6 iterations")
    frame, white, dark, words = vesicle.frames(run)
    seen = vesicle.seen(frame, white, dark, PIXELS, run.device)
    print(f"  {words}\n  {seen.lattice.verdict}")
    print(f"  haze: {100 * seen.haze.sum() / seen.counts.sum():.0f} % of the light")
    bench = prepared(seen, vesicle.camera(run.device, PIXELS), planes(run.quick),
                     2 if run.quick else 3, QUICK if run.quick else ITERATIONS)
    result = bench.volume("frame")
    found = bench.measured("frame", result)
    compare(bench, result)
    most = 8 if run.quick else 400
    known = vesicle.fitted(seen, bench.projector, bench.voxels, found, most=most)
    print(f"  shell fitted to the frame itself: radius {known.radii[1] * UM:.2f} um, along z "
          f"{known.radii[0] * UM:.2f} um; poles {100 * known.dim:.0f} % dimmer")
    sphere = bench.volume("sphere", vesicle.twin(seen, bench.projector, bench.voxels, known))
    like = bench.measured("sphere", sphere)
    path = run.picture.with_suffix(".ome.tif")
    write_volume(path, result.volume, planes=bench.voxels.planes, voxel=(bench.voxels.side,) * 2,
                 description={"residuals": result.residuals.tolist()}, replace=True)
    print(f"  -> {path}")
    lf = decode_raw(frame, seen.lattice, device=run.device, white=white, dark=dark)
    disparity = vesicle.camera(run.device).disparity(float(found.centre[0]))
    refocused = refocus(lf, disparity=disparity).to_numpy().astype(float)
    raw = np.maximum(frame.astype(float) - dark, 0)
    draw(run, raw, refocused, bench.voxels, (result, sphere), (found, like))


def draw(run: Run, raw: np.ndarray, refocused: np.ndarray, voxels: shell.Voxels,
         results: tuple[DeconvolutionResult, ...], shells: tuple[shell.Shell, ...]) -> None:
    """Frame, refocused picture, three orthogonal slices, ridges, and the sphere's slice."""
    figure = new_figure(13, 6.8)
    panels = figure.subplots(2, 4)
    centre, volume = shells[0].centre, results[0].volume
    half = raw.shape[1] / 2 * 6.5 / 60
    panels[0, 0].imshow(raw, cmap=LIGHT, vmax=np.percentile(raw, 99.8),
                        extent=(-half, half, half, -half))
    panels[0, 0].set_title("raw frame")
    half = refocused.shape[1] / 2 * 100 / 60
    panels[0, 1].imshow(refocused, cmap=LIGHT, vmin=0, extent=(-half, half, half, -half))
    panels[0, 1].set_title(f"refocused on its middle, z = {round(centre[0] * UM, 1) + 0.0:.1f} um")
    drawn = slice_of(panels[0, 2], volume, voxels, shells[0], "yx")
    slice_of(panels[0, 3], volume, voxels, shells[0], "yz")
    slice_of(panels[1, 2], volume, voxels, shells[0], "zx")
    slice_of(panels[1, 3], results[1].volume, voxels, shells[1], "zx")
    panels[1, 3].set_title("xz of the simulated sphere")
    for axes in (*panels[0], *panels[1, 2:]):
        scale_bar(axes)
    curves, angles = panels[1, :2]
    for word, colour, result, found in zip(("frame", "simulated sphere"), (BLUE, ORANGE), results,
                                           shells, strict=True):
        curves.semilogy(result.residuals, ".-", color=colour, label=word)
        draw_ridges(angles, result.volume, voxels, found, word, colour)
    curves.set(xlabel="iterations", title="relative residual")
    curves.legend()
    angles.axhline(shells[0].radii[1:].mean() * UM, color="0.4", lw=0.8, ls="--")
    angles.set(xlabel="degrees above the equator", ylabel="um from the centre", xlim=(-90, 90),
               title="where rays meet the shell", xticks=range(-90, 91, 45))
    angles.margins(y=0.15)
    angles.legend(loc="upper center", markerscale=4)
    figure.colorbar(drawn, ax=list(panels[:, 3]), shrink=0.6, ticks=(0, 0.1, 0.5, 1),
                    label=f"light of a voxel / {MOST} % of them")
    run.save(figure)


def slice_of(axes: Axes, volume: np.ndarray, voxels: shell.Voxels, found: shell.Shell, which: str
             ) -> Any:
    """A slice through a shell's centre, down one axis and across another; dashed: its equator."""
    (through,) = {0, 1, 2} - {"zyx".index(letter) for letter in which}
    down, across = ("zyx".index(letter) for letter in which)
    k = int(np.rint(voxels.index(found.centre)[through]))
    light = np.take(volume, k, axis=through) / np.percentile(volume, MOST)
    light = light if down < across else light.T
    first, last = voxels.first - voxels.step / 2, voxels.first + voxels.step * volume.shape
    ends = np.stack([first, last - voxels.step / 2]) * UM
    drawn = axes.imshow(np.minimum(light, 1), cmap=LIGHT, norm=PowerNorm(0.5, 0, 1),
                        interpolation="bilinear", extent=(*ends[:, across], *ends[::-1, down]))
    turn, r = np.linspace(0, 2 * np.pi, 361), found.radii[1:].mean()
    axes.plot(*((found.centre[k] + r * wave(turn)) * UM for k, wave in
                ((across, np.cos), (down, np.sin))), color="c", lw=0.7, ls=(0, (4, 6)))
    place = voxels.first[through] + k * voxels.step[through]
    axes.set(title=f"{''.join(sorted(which))} at {'zyx'[through]} = {place * UM:.1f} um",
             xlabel=which[1], ylabel=which[0])
    return drawn


def draw_ridges(axes: Axes, volume: np.ndarray, voxels: shell.Voxels, found: shell.Shell,
                word: str, colour: str) -> None:
    """Distances of ridges from the centre against the angle from the equator."""
    places, _ = shell.ridges(volume, voxels, shell.directions(), found.centre,
                             float(found.radii.mean()))
    away = places - found.centre
    r = np.linalg.norm(away, axis=1)
    axes.plot(np.degrees(np.arcsin(away[:, 0] / r)), r * UM, ".", ms=3, alpha=0.5, color=colour,
              label=word)


def scale_bar(axes: Axes) -> None:
    """10 um, in place of ticks."""
    axes.set(xlim=(-HALF, HALF), ylim=(HALF, -HALF), xticks=[], yticks=[], aspect="equal",
             facecolor="k")
    axes.plot([10, 20], [20, 20], color="w", lw=3, solid_capstyle="butt")
    axes.text(15, 18.6, "10 um", color="w", ha="center", va="bottom", fontsize=8)


if __name__ == "__main__":
    main()
