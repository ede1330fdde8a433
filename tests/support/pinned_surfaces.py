"""Cases of `pinned.py`: commands, files in TOML, figure scripts, and what is said of mistakes."""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinned_results as made
import tifffile
from click.testing import CliRunner
from PIL import Image
from pinned import HERE, add

import clplen
from clplen import batch, cameras, lightfield, microscopy, plot, wave
from clplen import io as files
from clplen.cli import main

STANDARD = """
[camera]
kind = "plenoptic1"
focal_length_mm = 30.0
object_distance_mm = 60.0
wavelength_nm = 532.0
pixels_per_lenslet = 15
[camera.microlenses]
pitch_um = 100.0
focal_length_mm = 2.0
count = [9, 11]
fill = "square"
[scene]
points_mm = [[0.1, -0.05, -1.0], [-0.1, 0.1, 2.0]]
[sensor]
exposure_electrons = 1e6
shot_noise = true
bit_depth = 12
full_well_electrons = 20000.0
"""
FOCUSED = """
[camera]
kind = "plenoptic2"
m = 0.2
focal_length_mm = 30.0
wavelength_nm = 532
pixels_per_lenslet = 20
[camera.microlenses]
pitch_um = 150
focal_length_mm = [10, 9.8]
count = [11, 12]
fill = "full"
[scene]
points_mm = [[0.2, -0.1, 1.0]]
[[scene.pictures]]
file = "small.png"
width_mm = 0.6
z_mm = 0.5
"""
SLIDE = """
[camera]
focal_length_mm = 120.0
wavelength_nm = 532.0
pixels_per_lenslet = 30
aperture_diameter_mm = 0.5
[camera.microlenses]
pitch_um = 150.0
focal_length_mm = 10.0
count = 7
[[scene.pictures]]
file = "small.png"
width_mm = 0.4
mode = "transmission"
[coherence]
spatial = "mask"
cell_um = 50.0
fwhm_nm = 10.0
wavelengths = 2
snapshots = 3
"""
MICROSCOPE = """
magnification = 10.0
na = 0.2
medium_index = 1.0
wavelength = 525.0
tubelens_focal_length = 200.0
ulens_pitch = 60.0
ulens_focal_length = 1500.0
pixel_size = 5.4545454545454541
num_slices = 3
um_per_slice = 40.0
supersample = 3
"""
FOURIER = """
[camera]
kind = "fourier_microscope"
magnification = 20
na = 0.3
medium_index = 1.0
wavelength_nm = 525.0
relay_mm = 50.0
pixel_um = 8.0
[camera.microlenses]
pitch_um = 500.0
focal_length_mm = 12.0
count = 3
[volume]
num_slices = 3
um_per_slice = 10.0
"""
JOB = """
output = "results"
[[inputs]]
files = "views.npy"
[inputs.layout]
flip_u = true
[stack]
disparities = "-1:1:3"
aperture = 3
[depth]
cue = "energy"
[all_in_focus]
[views]
at = [[2, 2.5]]
[light_field]
format = "zarr"
"""
FRAMES = """
output = "results"
[[inputs]]
files = "frame.tif"
[inputs.layout]
white = "white.tif"
[deconvolve]
psf = "psf.h5"
iterations = 3
prior = "tv"
residual = 0.001
"""
SIMULATIONS = """
output = "results"
formats = ["ome-zarr"]
[[simulations]]
camera = "standard.toml"
name = "depths"
[[simulations.sweep]]
key = "scene.points_mm.*.2"
values = [-1, 1]
name = "dz_mm"
[[scenes]]
kind = ["spheres"]
seeds = [0, 3]
shape = [20, 23]
views = [3, 4]
[stack]
"""
TEXTS = {
    "standard.toml": STANDARD, "focused.toml": FOCUSED, "slide.toml": SLIDE,
    "scope.toml": MICROSCOPE, "fourier.toml": FOURIER, "job.toml": JOB, "frames.toml": FRAMES,
    "simulations.toml": SIMULATIONS, "notes.h5": "hello", "broken.toml": "[camera\nkind =",
}  # fmt: skip


@lru_cache
def inputs() -> Path:
    """A folder with a small file of every kind that commands read."""
    folder = Path(tempfile.mkdtemp())
    lf, truth = made.scene()
    grey = np.uint8(200 * np.clip(lf.to_numpy(), 0, 1))
    np.save(folder / "views.npy", grey)
    (folder / "colour").mkdir()
    for v, u in np.ndindex(3, 4):
        pixels = np.stack([grey[v, u], 255 - grey[v, u], grey[v, u] // 2], axis=-1)
        Image.fromarray(pixels).save(folder / "colour" / f"view_{v}_{u}.png")
    Image.fromarray(grey[2, 3]).save(folder / "grey.png")
    Image.fromarray(grey[2, 3, ::6, ::6]).save(folder / "small.png")
    clplen.write_lightfield(folder / "metric.h5", made.scene_with_spacing())
    white = np.uint16(made.white_frame(9.7, (104, 131), 0.01))
    tifffile.imwrite(folder / "lenses.tif", np.uint16(white * made.samples(*white.shape)))
    tifffile.imwrite(folder / "flat.tif", white)
    clplen.write_raw(folder / "focused.h5", made.focused_raw(0.25))
    files.write_pfm(folder / "truth.pfm", truth.disparity)
    files.write_pfm(folder / "found.pfm", truth.disparity + 0.1 * made.samples(36, 44))
    for number, (tilt, z) in enumerate(((-0.5, 0.4), (0.4, 0.5), (0.1, 0.45), (0.7, 0.5))):
        np.save(folder / f"board_{number}.npy", made.board(tilt, z))
    files.write_intrinsics(folder / "known.json", made.known())
    microscopy.write_point_images(folder / "psf.h5", made.point_images())
    microscopy.write_point_images(folder / "flfm.h5", made.fourier_images())
    bead = made.scope(count=7, pupil={6: 4e-8}).expose(
        clplen.PointSources([(6e-6, -5e-6, 50e-6)], power=1e5)
    )
    tifffile.imwrite(folder / "bead.tif", np.uint16(np.round(bead.to_numpy())))
    light = made.microscope_white()
    frame = np.uint16(light / 10 * made.samples(*light.shape))
    tifffile.imwrite(folder / "white.tif", np.uint16(light))
    tifffile.imwrite(folder / "frame.tif", frame)
    series = np.stack([frame, frame // 2, frame // 3])
    tifffile.imwrite(folder / "frames.tif", series, photometric="minisblack")
    for number in range(3):
        tifffile.imwrite(folder / f"t{number}.tif", frame // (number + 1))
    for t, volume in enumerate(made.movie()):
        files.write_volume(
            folder / f"beads_{t}.ome.tif", np.float32(volume),
            planes=made.AXES[0], voxel=(5e-7, 6e-7),
        )  # fmt: skip
    np.save(folder / "volume.npy", made.samples(3, 15, 18))
    for name, text in TEXTS.items():
        (folder / name).write_text(text)
    return folder


def run(lines: str) -> dict[str, Any]:
    """Run commands beside the inputs; what they say, and in the present folder what they write."""
    shutil.copytree(inputs(), ".", dirs_exist_ok=True)
    said = {}
    for number, line in enumerate(lines.strip().splitlines()):
        words, _, target = line.strip().partition(" > ")
        words = [one for word in shlex.split(words) for one in expanded(word)]
        result = CliRunner().invoke(main, words)
        if isinstance(result.exception, Exception):
            raise result.exception
        if target:
            Path(target).write_text(result.stdout)
        said[f"{number}"] = {"status": result.exit_code, "out": timeless(result.stdout),
                             "err": timeless(result.stderr)}  # fmt: skip
    for path in [path for path in inputs().rglob("*") if path.is_file()]:
        path = path.relative_to(inputs())
        if path.is_file() and path.read_bytes() == (inputs() / path).read_bytes():
            path.unlink()
    return said


def expanded(word: str) -> list[str]:
    """As a shell does it with names of files."""
    return sorted(map(str, Path().glob(word))) or [word] if "*" in word else [word]


def timeless(text: str) -> str:
    """What a command says, without how long it took and what took longest."""
    text = re.sub(r"\b\d[\d.,]* (s|ms|min|frames a second)\b", r"N \1", text)
    text = re.sub(r"most of it to \w+", "most of it to WORK", text)
    return re.sub(r"^.*\r", "", text, flags=re.MULTILINE)


PLANES = "--disparities=-1:1:5"
COMMANDS = {
    "stack": f"stack views.npy -o stack.tif {PLANES}",
    "stack default": "stack metric.h5 -o stack.zarr",
    "stack aperture": f"stack colour -o stack.tif {PLANES} --aperture 2 --swap-uv --flip-v",
    "stack alphas": "stack metric.h5 -o stack.tif --alphas 0.9:1.1:4 --aperture 0.6",
    "stack memory": f"stack views.npy -o stack.tif {PLANES} --memory 1MiB",
    "stack focused": "stack focused.h5 -o stack.tif --m 0.2:0.3:3 --view 1 -0.5",
    "stack raw": f"stack lenses.tif --white flat.tif -o stack.tif {PLANES}",
    "depth": f"depth views.npy -o depth.pfm {PLANES}",
    "depth cues": f"""
        depth views.npy -o energy.tif {PLANES} --cue energy --confidence sure.pfm
        depth colour -o tensor.npy {PLANES} --cue structure-tensor --flip-u
        depth views.npy -o both.tif --memory 4MiB {PLANES} --cue correspondence
    """,
    "depth metric": f"""
        depth views.npy -o d.pfm {PLANES} --baseline-mm 1 --focal-length-mm 50 --pixel-um 10 \
--focus-m 2 --metric z.pfm --ply points.ply
        depth metric.h5 -o d.tif --aperture 3 --ply points.glb
    """.replace("\\\n", ""),
    "depth focused": "depth focused.h5 -o m.h5",
    "depth score": f"""
        depth views.npy -o found.pfm {PLANES} --force
        score found.pfm truth.pfm --border 3
        score found.pfm truth.pfm --border 3 --json
    """,
    "refocus": """
        refocus views.npy -o near.tif --disparity 0.8
        refocus colour -o far.png --disparity=-0.5 --interpolation cubic --limits 10:200
    """,
    "refocus more": f"""
        refocus views.npy -o at.png --at 12,20 {PLANES}
        refocus views.npy -o tilt.tif --tilt 5,5,-0.5 --tilt 30,5,0 --tilt 5,30,0.3
        refocus views.npy -o sharp.tif --all-in-focus {PLANES}
        refocus views.npy -o by.tif --depth-map truth.pfm
        refocus views.npy -o fine.tif --disparity 0.3 --upsample 2
    """,
    "render": """
        render views.npy -o left.tif --viewpoint 2.5 1.3 --disparity 0.3
        render views.npy -o median.tif --flatten median --disparity=-0.5
        render colour -o whole.png --aperture 2 --curve srgb
        render views.npy -o by.tif --depth-map truth.pfm --viewpoint 1 2.5
    """,
    "render sweeps": f"""
        render views.npy -o around.gif --sweep views --disparity 0.3 --seconds 0.2
        render views.npy -o focus.gif --sweep focus {PLANES}
    """,
    "render focused": """
        render focused.h5 -o basic.png --method basic --m 0.25
        render focused.h5 -o depth.tif --method depth
    """,
    "epi": """
        epi views.npy -o epi.tif --y 12 --v 2
        epi metric.h5 -o epi.png --x 9 --u 3
    """,
    "info": """
        info views.npy
        info views.npy --json
        info colour
        info metric.h5 --farthest 1
    """,
    "info files": """
        info truth.pfm
        info lenses.tif --white flat.tif --save-grid grid.json
        info focused.h5
        info beads_0.ome.tif
        info psf.h5
        info flfm.h5
        info grey.png --json
    """,
    "info toml": """
        info standard.toml
        info focused.toml
        info scope.toml
        info fourier.toml --json
    """,
    "quilt": f"quilt views.npy -o q.png --columns 3 --rows 2 --size 96x80 --aspect 0.75 {PLANES}",
    "lenticular": f"""
        lenticular --pitch-test -o test.tif --lpi 60 --dpi 150 --width 5cm
        lenticular views.npy -o print.png --lpi 40 --dpi 240 --width 2cm --disparity truth.pfm
        lenticular colour -o near.tif --lpi 30 --dpi 240 --width 2cm --distance 0.4 \
--thickness 0.6mm --lenses horizontal {PLANES}
    """.replace("\\\n", ""),
    "stereo": f"""
        stereo colour -o red.png {PLANES}
        stereo views.npy -o pair.png --kind side-by-side --baseline 4 --zero-parallax 0.2 {PLANES}
    """,
    "poses": """
        poses views.npy -o nerf --format nerf --infinity=-1.2
        poses colour -o colmap --format colmap --baseline-mm 5 --focal-length-mm 35 --pixel-um 9
        poses views.npy -o splats --format colmap --disparity truth.pfm --infinity=-1.2
    """,
    "view": """
        view views.npy -o page.html --no-depth --title Views --most-views 3 3
        view found.pfm truth.pfm --compare --truth truth.pfm -o compared.html
        view beads_*.ome.tif --time -o series.html --downscale 2
    """,
    "calibrate": """
        calibrate board_0.npy board_1.npy board_2.npy board_3.npy --board 4x5 --spacing 25mm \
-o camera.json
        depth board_2.npy -o d.pfm --intrinsics known.json --disparities=-1:1:5 --metric z.pfm
    """.replace("\\\n", ""),
    "simulate": """
        simulate standard.toml -o out
        info out/lightfield.h5
    """,
    "simulate focused": """
        simulate focused.toml -o out
        render out/raw.h5 -o sharp.tif
    """,
    "simulate slide": "simulate slide.toml -o out",
    "analyse": """
        analyse standard.toml -o compared --only sampling,psf,mtf,crosstalk --quick
        analyse standard.toml focused.toml -o both --only sampling
    """,
    "sampling": """
        sampling --pitch 6.6um --shape 3030 --wavelength 550nm --z 240mm
        sampling --pitch 5umx6.6um --shape 300x400 --wavelength 550nm --z 24mm --method rs \
--lens 120mm --diameter 3.6mm --arriving 240mm --lenslets 150um 10mm --pad 3
    """.replace("\\\n", ""),
    "microscope psf": """
        microscope psf scope.toml -o small.h5 --voxels 2 --planes-um=-30:30:2 --cut 0.02
        microscope psf fourier.toml -o fourier.h5 --cut 0.05
        microscope psf scope.toml -o half.h5 --half --num-slices 2 --um-per-slice 30 --binning 1
        info half.h5
    """,
    "microscope project": """
        microscope project volume.npy -c psf.h5 -o frame_of.tif
        microscope deconvolve frame_of.tif -c psf.h5 -o back.ome.tif --iterations 3 --pitch 11
    """,
    "microscope deconvolve": """
        microscope deconvolve frame.tif -c psf.h5 --white white.tif -o volume.ome.tif --max-iter 3
        microscope deconvolve frame.tif -c psf.h5 --white white.tif -o tv.ome.zarr --iterations 3 \
--prior tv --background 2 --gain 1.5 --accelerate --haze --keep-hot --radiometric
        info volume.ome.tif
    """.replace("\\\n", ""),
    "microscope series": """
        microscope deconvolve t*.tif -c psf.h5 --white white.tif -o series.ome.zarr \
--iterations 2 --batch 2 --prior time --rolling-background 2 --preview latest.png
        microscope deconvolve frames.tif -c psf.h5 --white white.tif -o out/{name}.ome.tif \
--iterations 2 --start decayed --residual noise
        microscope deconvolve t*.tif -c psf.h5 --white white.tif -o series.ome.zarr \
--iterations 2 --batch 2 --prior time --rolling-background 2
    """.replace("\\\n", ""),
    "microscope objects": """
        microscope points beads_0.ome.tif -o points.csv --snr 5
        microscope regions beads_*.ome.tif --time mean -o cells.csv --labels labels.ome.tif
        microscope traces beads_*.ome.tif --labels labels.ome.tif -o traces.csv --window 3
        microscope traces beads_*.ome.tif --points points.csv --radius-um 2 -o about.csv
        microscope track beads_*.ome.tif -o tracks.csv --step-um 3 --gaps 1 --napari tracks.npy
        microscope track beads_*.ome.tif -o moved.csv --step-um 6,3,3 --regions --motion straight
    """,
    "microscope views": """
        microscope views beads_0.ome.tif -o views.png --scale root
        microscope views beads_*.ome.tif -o film.gif --slices 4,8,12
        microscope views beads_*.ome.tif -o all.png --montage z
    """,
    "microscope pupil": """
        microscope pupil bead.tif -c scope.toml --planes-um -75:75:7 --beads --terms 6,8 \
--gain 1 -o found.toml
    """.replace("\\\n", ""),
    "batch": """
        batch run job.toml --dry-run
        batch job.toml
        batch job.toml
        batch status job.toml --verify
    """,
    "batch frames": """
        batch frames.toml
        batch status frames.toml
    """,
    "batch simulations": """
        batch simulations.toml
        batch status simulations.toml
    """,
    "demo": "demo --points -o demo --lenslets 53",
    "examples": """
        simulate --example > camera.toml
        info camera.toml
        batch --example
        microscope psf --example > guv.toml
        info guv.toml
        microscope psf --fourier > flfm.toml
        info flfm.toml
        analyse --example standard
        analyse --example focused
    """,
    "help": "--help\nbench --list\nworker --help\ndevices --help",
}
for name, lines in COMMANDS.items():
    add(f"$ {name}", lambda lines=lines: run(lines))


# Files in TOML, and figure scripts


def job_blocks() -> dict[str, str]:
    """The blocks of the documentation that are job or parameter files, by page and number."""
    found = {}
    for page in sorted((HERE / "docs").rglob("*.md")):
        blocks = re.findall(r"^```toml\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)
        found |= {f"{page.stem} {number}": block for number, block in enumerate(blocks)}
    return found


def read_block(text: str) -> Any:
    Path("block.toml").write_text(text)
    if "output =" in text:
        return batch.Job.read("block.toml").contents()
    return run("info block.toml")


for name, text in job_blocks().items():
    add(f"toml {name}", lambda text=text: read_block(text))


def simulate_example(path: Path) -> Any:
    """What a camera file of the examples says, and the light of a point through a part of it."""
    text = re.sub(r"count = \S+( \d+\])?", "count = [5, 6]", path.read_text("utf-8"))
    text = re.sub(r"shape = \[.*?\]", "shape = [51, 60]", text)
    text = re.sub(r"points_mm = \[.*?\],?\s*\]", "points_mm = [[0, 0, 0]]", text, flags=re.S)
    Path("part.toml").write_text(text)
    return run(f"info {path}\ninfo part.toml\nsimulate part.toml -o out")


for path in sorted((HERE / "examples" / "cameras").glob("*.toml")):
    add(f"toml example {path.stem}", lambda path=path: simulate_example(path))


def draw(script: Path) -> str:
    """What a figure script prints; its picture lies in the present folder."""
    old, said = (sys.argv, sys.path[:]), io.StringIO()
    sys.argv, sys.path[:0] = [str(script), "--quick", "-o", "."], [str(script.parent)]
    try:
        with contextlib.redirect_stdout(said):
            runpy.run_path(str(script), run_name="__main__")
    finally:
        sys.argv, sys.path[:] = old
    return timeless(said.getvalue())


for script in sorted((HERE / "examples").glob("fig_*.py"))[::20]:
    add(f"figure {script.stem}", lambda script=script: draw(script))


# What is said of mistakes

LF = clplen.LightField.from_array(made.samples(3, 5, 16, 20))
STEPS = np.linspace(-1, 1, 5)
MLA = clplen.MicrolensArray(150e-6, 10e-3, count=5)


def camera(**words: Any) -> Any:
    words = {"focal_length": 0.12, "mla": MLA, "wavelength": made.LAM} | words
    return clplen.PlenopticCamera.type1(**({"pixels_per_lenslet": 15} | words))


def beam(size: int = 64, pitch: float = 1e-5) -> clplen.Field:
    return wave.plane_wave(clplen.Grid((size, size), pitch), wavelength=5e-7)


def text_file(name: str, text: str | bytes) -> str:
    Path(name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return name


def job(text: str) -> batch.Job:
    head = "" if "output" in text else 'output = "out"\n[[inputs]]\nfiles = "*.npy"\n'
    return batch.Job.read(text_file("job.toml", head + text))


def camera_file(old: str, new: str) -> Any:
    assert old in STANDARD
    return clplen.read_camera(text_file("camera.toml", STANDARD.replace(old, new)))


def read(name: str, values: np.ndarray, **words: Any) -> Any:
    np.save(name, values)
    return clplen.read_lightfield(name, **words)


MISTAKES: dict[str, Callable[[], Any]] = {
    # waves
    "grid of one number": lambda: clplen.Grid(64, 1e-6),
    "grid of no samples": lambda: clplen.Grid((0, 64), 1e-6),
    "grid pitch": lambda: clplen.Grid((64, 64), -1e-6),
    "grid pitch in nanometres": lambda: clplen.Grid((64, 64), 500.0),
    "field shape": lambda: clplen.Field.from_array(np.ones((8, 9)), made.GRID, wavelength=5e-7),
    "field wavelength": lambda: wave.plane_wave(made.GRID, wavelength=532),
    "field NaN": lambda: clplen.Field.from_array(
        np.full(made.GRID.shape, np.nan), made.GRID, wavelength=5e-7
    ),
    "aperture of no width": lambda: clplen.aperture(beam(), 0),
    "aperture shape": lambda: clplen.aperture(beam(), 1e-4, shape="round"),
    "aperture edges": lambda: clplen.aperture(beam(), 1e-4, edges="hard"),
    "annular aperture": lambda: wave.annular_aperture(beam(), 1e-4, inner=2e-4),
    "lens aliased": lambda: clplen.thin_lens(beam(), 1e-3),
    "lens warned": lambda: clplen.thin_lens(beam(), 1e-3, aliasing="warn"),
    "lens form": lambda: clplen.thin_lens(beam(), 0.1, form="perfect"),
    "lens without power": lambda: clplen.thin_lens(beam(), 0),
    "propagation method": lambda: clplen.propagate(beam(), 0.01, method="fft"),
    "propagation pad": lambda: clplen.propagate(beam(), 0.01, pad=0.5),
    "propagation lens": lambda: clplen.propagate(beam(), 0.01, lens=0.1),
    "propagation infinite": lambda: clplen.propagate(beam(), np.inf),
    "propagation of an array": lambda: clplen.propagate(np.ones((8, 8)), 0.01),
    "propagation aliased": lambda: clplen.propagate(beam(), 0.5, method="rs"),
    "zernike index": lambda: clplen.phase_plate(beam(), {0: 1e-8}, diameter=3e-4),
    "noll": lambda: wave.noll(0),
    "array lattice": lambda: clplen.MicrolensArray(1e-4, 1e-3, count=3, lattice="triangular"),
    "array fill": lambda: clplen.MicrolensArray(1e-4, 1e-3, count=3, fill="half"),
    "array pitch": lambda: clplen.MicrolensArray(0.15, 1e-3, count=3),
    "array count": lambda: clplen.MicrolensArray(1e-4, 1e-3, count=(3, 0)),
    "array focal lengths": lambda: clplen.MicrolensArray(1e-4, [1e-3, 2e-3], count=3),
    "array aliased": lambda: MLA.apply(beam()),
    "mask cells": lambda: next(
        clplen.Coherence(wave.RandomPhaseMask(7e-5)).snapshots(made.GRID, wavelength=5e-7)
    ),
    "mask cell": lambda: wave.RandomPhaseMask(-1e-5),
    "source size": lambda: wave.ExtendedSource(0.0, 0.1),
    "spectrum width": lambda: clplen.Spectrum.gaussian(5e-7, -1e-8),
    "spectrum table": lambda: clplen.Spectrum.tabulated([5e-7, 4e-7], [1, 2]),
    "spectrum file": lambda: clplen.Spectrum.read(text_file("a.csv", "a,b\n")),
    "illuminant": lambda: wave.SpectralDistribution.illuminant("F2"),
    "glass": lambda: wave.Glass.named("BK 7"),
    "glass range": lambda: wave.Glass.named("N-BK7").index(1e-5),
    "system of nothing": lambda: clplen.OpticalSystem([]),
    "system of words": lambda: clplen.OpticalSystem(["lens"]),
    "target group": lambda: wave.usaf1951(made.GRID, groups=[20], aliasing="raise"),
    # light fields
    "light field of a picture": lambda: clplen.LightField.from_array(np.zeros((32, 32))),
    "light field NaN": lambda: clplen.LightField.from_array(np.full((3, 3, 8, 8), np.nan)),
    "light field of text": lambda: clplen.LightField.from_array("views"),
    "light field spacing": lambda: clplen.LightField.from_array(
        made.samples(3, 3, 8, 8), spacing=(1, 1, 1)
    ),
    "view outside": lambda: LF.view(3, 0),
    "epi of a point": lambda: LF.epi(y=3, x=3),
    "flatten": lambda: LF.flatten("mode"),
    "aperture of views": lambda: LF.render(aperture=0),
    "aperture words": lambda: LF.render(aperture="f/x"),
    "refocus nowhere": lambda: clplen.refocus(LF),
    "refocus twice": lambda: clplen.refocus(LF, alpha=1, disparity=1),
    "refocus by alpha": lambda: clplen.refocus(LF, alpha=1.1),
    "refocus interpolation": lambda: clplen.refocus(LF, disparity=1, interpolation="sinc"),
    "refocus map": lambda: clplen.refocus(LF, disparity=np.zeros((3, 3))),
    "stack of no planes": lambda: clplen.focal_stack(LF, disparities=[]),
    "stack of text": lambda: clplen.focal_stack(LF, disparities="-1:1:5"),
    "stack memory": lambda: clplen.focal_stack(
        clplen.StoredLightField.from_light_field(LF), disparities=STEPS, memory=1000
    ),
    "depth of a plane": lambda: clplen.depth_map(LF, disparities=[0]),
    "depth cue": lambda: clplen.depth_map(LF, disparities=STEPS, cue="stereo"),
    "depth planes in no order": lambda: clplen.depth_map(LF, disparities=[0, 1, -1]),
    "depth of one view": lambda: clplen.depth_map(made.samples(1, 1, 16, 16), disparities=STEPS),
    "all in focus map": lambda: clplen.all_in_focus(LF, depth=np.zeros((2, 2))),
    "alpha method": lambda: clplen.estimate_alpha(LF, method="best"),
    "alpha without spacing": lambda: clplen.estimate_alpha(LF),
    "metric depth": lambda: lightfield.metric_depth(
        [1.0], baseline=1.0, focal_length=50, pixel_pitch=10
    ),
    "lattice of noise": lambda: clplen.estimate_lattice(made.samples(60, 70)),
    "lattice of zeros": lambda: clplen.estimate_lattice(np.zeros((60, 70))),
    "decode white": lambda: clplen.decode_raw(
        np.ones((40, 40)), clplen.estimate_lattice(made.white_frame(9.7, (104, 131))),
        white=np.ones((41, 40)),
    ),
    "decode bayer": lambda: clplen.decode_raw(
        np.ones((104, 131)), clplen.estimate_lattice(made.white_frame(9.7, (104, 131))),
        bayer="RGB",
    ),
    "annulus": lambda: lightfield.annulus((5, 5), 2, 1),
    "corners of noise": lambda: lightfield.find_corners(made.samples(3, 3, 40, 50), (4, 5)),
    "calibrate one board": lambda: lightfield.calibrate([made.board(0.5, 0.4)], (4, 5), 0.025),
    "focused rendering of a standard camera": lambda: clplen.render_focused(
        camera().expose(clplen.PointSources((0, 0, 0)), model="rays")
    ),
    # cameras
    "camera without aperture": lambda: camera(aperture_diameter=0),
    "camera focal length": lambda: camera(focal_length=120),
    "camera wavelength": lambda: camera(wavelength=532),
    "camera pixels": lambda: camera(pixels_per_lenslet=0),
    "camera distances": lambda: camera(object_distance=0.1),
    "camera unknown": lambda: camera(f_number=4),
    "camera itself": lambda: clplen.PlenopticCamera(),
    "focused without m": lambda: clplen.PlenopticCamera.type2(
        focal_length=0.12, mla=MLA, wavelength=5e-7, pixels_per_lenslet=15
    ),
    "microscope aperture": lambda: clplen.PlenopticCamera.microscope(
        magnification=10, na=1.2, wavelength=525e-9, pixels_per_lenslet=11, mla=MLA
    ),
    "expose model": lambda: camera().expose(clplen.PointSources((0, 0, 0)), model="beams"),
    "expose far": lambda: camera().expose(clplen.PointSources((0.1, 0, 0))),
    "expose behind": lambda: camera().expose(clplen.PointSources((0, 0, -0.5))),
    "expose nothing": lambda: camera().expose([]),
    "points": lambda: clplen.PointSources([(0, 0)]),
    "points power": lambda: clplen.PointSources([(0, 0, 0)], power=[1, 2]),
    "picture mode": lambda: clplen.PicturePlane(np.ones((3, 3)), 1e-3, mode="reflection"),
    "picture slide": lambda: camera().expose(
        clplen.PicturePlane(np.ones((3, 3)), 1e-4, mode="transmission")
    ),
    "sensor bits": lambda: clplen.Sensor(exposure=1e5, bit_depth=40),
    "sensor full well": lambda: clplen.Sensor(bit_depth=8),
    "pixels fill": lambda: cameras.PixelArray(fill_factor=1.5),
    "filters": lambda: cameras.ColorFilterArray.bayer("RGBX"),
    "surface": lambda: clplen.SurfaceScene([1, 2]),
    # microscopy and analysis
    "point images planes": lambda: clplen.point_images(made.scope(), []),
    "point images of a camera": lambda: clplen.point_images(camera(), [0.0]),
    "projector volume": lambda: made.projector("lenslets").forward(np.ones((2, 3, 3))),
    "deconvolve frame": lambda: clplen.deconvolve(np.ones((3, 3)), made.projector("lenslets")),
    "deconvolve prior": lambda: clplen.deconvolve(
        np.ones(made.projector("lenslets").frame_shape), made.projector("lenslets"), prior="l1"
    ),
    "deconvolve iterations": lambda: clplen.deconvolve(
        np.ones(made.projector("lenslets").frame_shape), made.projector("lenslets"), iterations=0
    ),
    "deconvolve dark": lambda: clplen.deconvolve(
        np.zeros(made.projector("lenslets").frame_shape), made.projector("lenslets")
    ),
    "preparation of zeros": lambda: microscopy.preparation(11, white=np.zeros((90, 90))),
    "points in a picture": lambda: microscopy.find_points(np.ones((8, 8))),
    "tracks step": lambda: microscopy.track_points([], step=-1),
    "compare analyses": lambda: made.analysis.compare({"a": camera()}, only=["speed"]),
    "score shapes": lambda: made.analysis.score(np.ones((8, 8)), np.ones((9, 8))),
    "score border": lambda: made.analysis.score(np.ones((8, 8)), np.ones((8, 8)), border=9),
    "plot scale": lambda: plot.picture(LF.view(1, 1), scale="square"),
    # files
    "device": lambda: clplen.Device.open("no such device"),
    "no file": lambda: clplen.read_lightfield("missing.h5"),
    "no light field": lambda: clplen.read_lightfield(text_file("a.h5", "hello")),
    "empty file": lambda: clplen.read_lightfield(text_file("a.npy", b"")),
    "cut file": lambda: clplen.read_lightfield(text_file("a.npy", b"\x93NUMPY\x01\x00v\x00{'de")),
    "three axes": lambda: read("a.npy", np.ones((3, 8, 8))),
    "axes": lambda: read("a.npy", np.ones((3, 3, 8, 8)), order="uvxz"),
    "option of another kind": lambda: read("a.npy", np.ones((3, 3, 8, 8)), pattern="{v}"),
    "unknown option": lambda: read("a.npy", np.ones((3, 3, 8, 8)), flip_x=True),
    "largest allocation": lambda: read("a.npy", np.ones((3, 3, 8, 8)), max_bytes=100),
    "folder of nothing": lambda: (Path("empty").mkdir(), clplen.read_lightfield("empty")),
    "raw file": lambda: clplen.read_raw(text_file("a.h5", "hello")),
    "pfm": lambda: files.read_pfm(text_file("a.pfm", "P5\n3 3\n")),
    "picture": lambda: files.read_picture(text_file("a.png", b"\x89PNG\r\n\x1a\nxx")),
    "volume": lambda: files.read_volume(text_file("a.tif", "II")),
    "lattice file": lambda: files.read_lattice(text_file("a.json", "{}"), (9, 9)),
    "raytrix": lambda: files.read_raytrix(text_file("a.xml", "<a/>")),
    "point image file": lambda: microscopy.read_point_images(text_file("a.h5", "")),
    "written over": lambda: files.write_npy(text_file("a.npy", "mine"), np.ones(3)),
    "written as": lambda: files.write_depth("a.jpg", clplen.depth_map(LF, disparities=STEPS)),
    "written where": lambda: files.write_pfm("nowhere/a.pfm", np.ones((3, 3))),
    "written complex": lambda: files.write_picture("a.png", 1j * np.ones((3, 3))),
    # jobs and camera files
    "job unknown key": lambda: job("[stack]\ndisparitys = [1]\n"),
    "job planes": lambda: job('[stack]\ndisparities = "1:2"\n'),
    "job both": lambda: job("[stack]\ndisparities = [1, 2]\nalphas = [1, 2]\n"),
    "job aperture": lambda: job('[stack]\naperture = "wide"\n'),
    "job cue": lambda: job('[depth]\ncue = "stereo"\n'),
    "job without work": lambda: job(""),
    "job without inputs": lambda: job('output = "out"\n[stack]\n'),
    "job memory": lambda: job('output = "o"\nmemory = "much"\n[[inputs]]\nfiles = "a"\n[stack]\n'),
    "job scene": lambda: job('output = "o"\n[[scenes]]\nkind = "sphere"\n[stack]\n'),
    "job sweep": lambda: job(
        'output = "o"\n[[scenes]]\nkind = "bars"\n[[scenes.sweep]]\nkey = "z"\nvalues = [1]\n'
    ),
    "job prior": lambda: job('[deconvolve]\npsf = "a.h5"\nprior = "time"\n'),
    "job deconvolve": lambda: job("[deconvolve]\niterations = 0\n"),
    "job of no TOML": lambda: job("output = \n"),
    "job without files": lambda: batch.run_job(job("[stack]\n")),
    "camera file kind": lambda: camera_file('"plenoptic1"', '"plenoptic3"'),
    "camera file type": lambda: camera_file("532.0", '"green"'),
    "camera file range": lambda: camera_file("532.0", "-532.0"),
    "camera file unit": lambda: camera_file("wavelength_nm = 532.0", "wavelength_nm = 5.3e-7"),
    "camera file unknown": lambda: camera_file("count =", "counts ="),
    "camera file focal length": lambda: camera_file("focal_length_mm = 30.0\n", ""),
    "camera file distances": lambda: camera_file("object_distance_mm = 60.0", "a_mm = 2.0"),
    "camera file lattice": lambda: camera_file('fill = "square"', 'lattice = "rhombic"'),
    "camera file sensor": lambda: camera_file("exposure_electrons = 1e6\n", ""),
    "camera file of no TOML": lambda: clplen.read_camera(text_file("a.toml", "[camera\n")),
    "no camera file": lambda: clplen.read_camera("none.toml"),
}  # fmt: skip
for name, mistake in MISTAKES.items():
    add(f"mistake {name}", mistake)

WRONG_COMMANDS = {
    "command": "stak views.npy",
    "option": "stack views.npy -o a.tif --disparity 1",
    "stack": """
        stack views.npy
        stack missing.npy -o a.tif
        stack notes.h5 -o a.tif
        stack views.npy -o a.jpg
        stack views.npy -o a.tif --disparities 1
        stack views.npy -o a.tif --disparities -1:1:5
        stack views.npy -o a.tif --disparities=-1:1:5 --alphas 0.9:1.1:3
        stack views.npy -o a.tif --alphas 0.9:1.1:3
        stack views.npy -o a.tif --m 0.1
        stack views.npy -o a.tif --aperture much
        stack views.npy -o a.tif --memory 1KiB
        stack views.npy -o a.tif --white flat.tif
        stack views.npy -o grey.png
        stack views.npy -o notes.h5
        stack views.npy -o a.tif --device none
    """,
    "depth": """
        depth views.npy -o a.png
        depth views.npy -o a.pfm --cue stereo
        depth views.npy -o a.pfm --metric z.pfm
        depth views.npy -o a.pfm --baseline-mm 1
        depth views.npy -o a.pfm --confidence a.pfm
        depth focused.h5 -o a.pfm --disparities=-1:1:5
        depth views.npy -o a.pfm --ply a.obj
    """,
    "refocus": """
        refocus views.npy -o a.tif
        refocus views.npy -o a.tif --disparity 1 --all-in-focus
        refocus views.npy -o a.tif --at 100,100
        refocus views.npy -o a.tif --tilt 1,1
        refocus views.npy -o a.tif --depth-map grey.png
        refocus views.npy -o a.tif --disparity 1 --curve bright
    """,
    "layout": """
        info colour --pattern a_{v}.png
        info colour --views 5 5
        info views.npy --order uv
        info views.npy --dataset x
        info lenses.tif
        info lenses.tif --white grey.png
        info lenses.tif --white flat.tif --bayer RGB
        info colour --positions none.csv
        info metric.h5 --dataset other
        info broken.toml
    """,
    "displays": """
        quilt views.npy -o a.png --display large
        quilt views.npy -o a.png --columns 3
        lenticular -o a.tif --lpi 60
        lenticular views.npy -o a.tif --lpi 60 --dpi 90
        stereo views.npy -o a.png --baseline 99
        poses views.npy -o a --format nerf --infinity 2
        poses views.npy -o colour --format nerf
        epi views.npy -o a.tif --y 1 --x 2
        render views.npy -o a.gif
        render views.npy -o a.tif --viewpoint 9 9
        view views.npy --quality 200
        view found.pfm views.npy --compare -o a.html
    """,
    "cameras": """
        simulate broken.toml -o out
        simulate scope.toml -o out
        analyse standard.toml -o a --only speed
        analyse standard.toml -o a --depths-mm 1:2
        sampling --pitch 6 --shape 30 --wavelength 550nm --z 1
        sampling --pitch 6um --shape 30 --wavelength 550nm
        calibrate views.npy --board 4x5 --spacing 25mm -o a.json
        calibrate board_0.npy --board 4 --spacing 25mm -o a.json
        score views.npy truth.pfm
        score found.pfm grey.png
    """,
    "microscope": """
        microscope psf standard.toml -o a.h5
        microscope psf scope.toml -o a.h5 --planes-um 1
        microscope psf scope.toml -o a.h5 --cut 2
        microscope project views.npy -c psf.h5 -o a.tif
        microscope project volume.npy -c truth.pfm -o a.tif
        microscope deconvolve frame.tif -c psf.h5 -o a.ome.tif
        microscope deconvolve frame.tif -c psf.h5 --white white.tif -o a.jpg
        microscope deconvolve frame.tif -c psf.h5 --white white.tif -o a.ome.tif --prior l1
        microscope deconvolve frame.tif -c psf.h5 --white white.tif -o a.ome.tif --strength 2
        microscope deconvolve frame.tif -c psf.h5 --white white.tif -o a.ome.tif --residual low
        microscope deconvolve frame.tif -c psf.h5 --white grey.png -o a.ome.tif
        microscope deconvolve frame.tif -c psf.h5 --white white.tif -o a.ome.tif --start previous
        microscope deconvolve frame.tif -c psf.h5 --white white.tif -o a.ome.tif --motion-um 1
        microscope points grey.png -o a.csv
        microscope track beads_0.ome.tif -o a.csv
        microscope traces beads_0.ome.tif -o a.csv
        microscope views beads_0.ome.tif -o a.doc
        microscope pupil bead.tif -c scope.toml --planes-um 0:1:1 --terms 3
    """,
    "batch": """
        batch broken.toml
        batch none.toml
        batch status none.toml
        batch job.toml --workers 0
        batch job.toml --scheduler tcp://10.0.0.1:8786
        worker tcp://10.0.0.1:8786
        bench nothing
    """,
}
for name, lines in WRONG_COMMANDS.items():
    add(f"wrong {name}", lambda lines=lines: run(lines))
