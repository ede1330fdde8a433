"""Every block of the README and the guides runs, on small samples of the names that it uses.

A block that does not run says so, with the reason, in an HTML comment before it (`not run`); one
that takes long runs with the marker `thorough` only, and what takes minutes with `nightly`.
"""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import docpages
import numpy as np
import pytest
import scipy.io
import tifffile
from reference_lattice import lattice, white
from scipy.ndimage import gaussian_filter
from setups_focused import captured

import clplen
from clplen import Device, LightField, MicrolensArray, PlenopticCamera, io

PATTERN = "IMG_0001_{n:03d}_{u:02d}_{v:02d}.png"
Names = dict[str, Any]


def views(V: int, U: int, ny: int, nx: int) -> np.ndarray:
    """uint8 (v, u, y, x, 3) of a textured plane at disparity -0.65."""
    texture = gaussian_filter(np.random.default_rng(1).random((ny + 40, nx + 40, 3)), (2, 2, 0))
    texture = np.uint8(255 * (texture - texture.min()) / np.ptp(texture))
    moved = [[np.roll(texture, (round(0.65 * v), round(0.65 * u)), (0, 1)) for u in range(U)]
             for v in range(V)]  # fmt: skip
    return np.array(moved)[:, :, 20:-20, 20:-20]


def flower(V: int, U: int, ny: int, nx: int) -> None:
    Path("flower").mkdir()
    for number, (v, u) in enumerate(np.ndindex(V, U), 1):
        name = PATTERN.format(n=number, u=u + 1, v=v + 1)
        io.write_picture(Path("flower", name), views(V, U, ny, nx)[v, u])


def frames(pitch: float, count: int, degrees: float = 0.0) -> Names:
    """Raw frame, white image and dark frame, as arrays and in files."""
    side = round(pitch * count)
    true = lattice("square", pitch, degrees=degrees, origin=(side / 2 - 0.5, side / 2 - 0.5))
    even = white((side, side), true, vignetting=0.2)
    y, x = np.indices((side, side))
    dark = np.random.default_rng(1).integers(98, 103, (side, side))
    scene = even * (0.6 + 0.4 * np.cos(0.05 * y) * np.cos(0.07 * x))
    found = {"frame": 2e4 * scene + dark, "white": 3e4 * even + dark, "dark": dark}
    made = {name: values.astype(np.uint16) for name, values in found.items()}
    for name, values in made.items():
        tifffile.imwrite(f"{name}.tif", values)
    for name in ("next", "guv", "t0", "t1"):
        tifffile.imwrite(f"{name}.tif", made["frame"])
    return made


def light_field() -> LightField:
    return LightField.from_array(views(5, 5, 40, 50), device=Device.open())


# What a reader of each page has: files in the folder, and names of their own.


def readme() -> Names:
    flower(6, 5, 170, 180)
    frames(15.4, 18)
    return {"L": np.random.default_rng(3).random((6, 5, 32, 36), np.float32)}


def aberrations() -> Names:
    lenslets = MicrolensArray(150e-6, 10e-3, count=15, fill="full")
    camera = PlenopticCamera.type1(
        focal_length=0.03,
        mla=lenslets,
        wavelength=532e-9,
        pixels_per_lenslet=16,
        device=Device.open(),
    )
    return {"camera": camera}


def batch() -> Names:
    Path("captures").mkdir()
    io.write_lightfield("captures/flower.h5", light_field())
    io.write_lightfield("huge.zarr", light_field())
    planes = np.linspace(-1, 1, 3)
    return {"device": Device.open(), "planes": planes, "clplen": clplen}


def formats() -> Names:
    flower(5, 5, 40, 50)
    frames(11.2, 14)
    depth = clplen.depth_map(light_field(), disparities=[-1, -0.5, 0])
    names = {"read_lightfield": io.read_lightfield, "write_ply": io.write_ply}
    return {"depth": depth, "colours": None, "points_of": io.points_of, **names}


def calibration() -> Names:
    return frames(11.2, 14)


def conventions() -> Names:
    flower(5, 5, 64, 72)
    return {}


def focused() -> Names:
    made = captured()
    io.write_raytrix("shot.xml", made.calibration)
    shot, flat = (np.round(values * 65535).astype(np.uint16) for values in (made.image, made.white))
    for name, values in (("shot", shot), ("raw", shot), ("white", flat)):
        io.write_picture(f"{name}.tif", values)
    Path("camera.toml").write_text(FOCUSED)
    return {"white": made.white}


def rendering() -> Names:
    flower(6, 5, 256, 256)
    return {}


def microscope() -> Names:
    frames(15.4, 18)
    return {}


def microscope_tracks() -> Names:
    """Beads that move, and cells of which one lights up."""
    rng = np.random.default_rng(1)
    shape, frames = (12, 40, 48), 8
    index = np.indices(shape)
    um = {"PhysicalSizeZ": 1.0, "PhysicalSizeY": 0.5, "PhysicalSizeX": 0.5}
    units = {f"{name}Unit": "µm" for name in um}

    def spot(centre: Any, sigma: float) -> Any:
        far = [((i - c) / sigma) ** 2 for i, c in zip(index, centre, strict=True)]
        return np.exp(-sum(far) / 2)

    def write(name: str, volumes: list[Any]) -> None:
        values = np.array(volumes) + rng.normal(0, 1, (frames, *shape))
        about = {"axes": "TZYX", **um, **units}
        tifffile.imwrite(name, values.astype(np.float32), metadata=about)

    beads = [(4, 10, 12), (7, 28, 30)]
    write("series.ome.tif", [
        sum(50 * spot((z, y + t, x + t), 1.3) for z, y, x in beads) for t in range(frames)
    ])  # fmt: skip
    cells = [spot((5, 14, 12), 3.0), spot((6, 25, 34), 3.0)]
    write("cells.ome.tif", [
        5 + 40 * cells[0] + (40 + 20 * (t > 4)) * cells[1] for t in range(frames)
    ])  # fmt: skip
    return {}


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
points_mm = [[0.2, -0.1, 1.0], [-0.3, 0.2, 0.5], [0.0, 0.3, 0.0]]
"""


def viewer() -> Names:
    flower(3, 3, 48, 64)
    return {}


def own_light_field() -> Names:
    flower(6, 5, 170, 180)
    return frames(15.4, 18)


def small_flower() -> Names:
    flower(5, 5, 64, 72)
    return {}


def larger_than_memory() -> Names:
    io.write_lightfield("huge.zarr", light_field())
    return {}


def matlab_and_numpy() -> Names:
    scipy.io.savemat("lightfield.mat", {"L": views(5, 5, 40, 50).transpose(1, 0, 2, 3, 4)})
    return {}


def white_images() -> Names:
    return frames(15.4, 18)


SAMPLES: dict[str, Callable[[], Names]] = {
    "README.md": readme,
    **{f"docs/{made.__name__}.md": made
       for made in (aberrations, batch, calibration, conventions, focused, formats, microscope,
                    microscope_tracks, rendering, viewer)},
    "docs/microscope_series.md": microscope,
    "docs/start/own_light_field.md": own_light_field,
    "docs/howto/larger_than_memory.md": larger_than_memory,
    "docs/howto/looking_glass.md": small_flower,
    "docs/howto/stereo_and_lenticular.md": small_flower,
    "docs/howto/matlab_and_numpy.md": matlab_and_numpy,
    "docs/howto/napari_and_fiji.md": small_flower,
    "docs/howto/point_cloud.md": small_flower,
    "docs/howto/nerf_and_splats.md": small_flower,
    "docs/howto/refocus_in_metres.md": small_flower,
    "docs/howto/views_in_wrong_order.md": small_flower,
    "docs/howto/white_image_not_found.md": white_images,
}  # fmt: skip


BRIDGES = "docs/howto/train_with_torch.md"
# Pages whose blocks take more than a second.
LONG = (
    "README.md",
    "docs/batch.md",
    "docs/calibration.md",
    "docs/focused.md",
    "docs/fourier_microscope.md",
    "docs/gradients.md",
    "docs/howto/four_f_filter.md",
    "docs/howto/inline_hologram.md",
    "docs/howto/compare_designs.md",
    "docs/howto/napari_and_fiji.md",
    "docs/howto/nerf_and_splats.md",
    "docs/howto/phone_or_slider.md",
    "docs/howto/point_cloud.md",
    "docs/howto/psf_of_a_lens.md",
    "docs/howto/refocus_in_metres.md",
    "docs/howto/stereo_and_lenticular.md",
    "docs/howto/white_image_not_found.md",
    "docs/microscope_lattices.md",
    "docs/microscope_tracks.md",
    "docs/propagation.md",
    "docs/rendering.md",
    "docs/scenes.md",
    "docs/start/first_picture.md",
    "docs/start/own_light_field.md",
    "docs/tutorials/exercises.md",
)


def has(page: str, mark: str) -> bool:
    return any(block.mark == mark for block in docpages.blocks(page))


def run(pages: Iterable[str], marks: tuple[str, ...], folder: Path, patch: Any) -> None:
    """Run the blocks of pages, each page in a folder of its own; raise all that fails."""
    failures = []
    for page in pages:
        reader = folder / page.replace("/", " ")
        reader.mkdir()
        patch.chdir(reader)
        try:
            names = SAMPLES.get(page, dict)()
            names["__name__"] = "reader"
            for block in docpages.blocks(page):
                if block.mark in marks:
                    docpages.run_block(block, names)
        except Exception:
            failures.append(f"{page}: {traceback.format_exc()}")
    assert not failures, "\n".join(failures)


def test_the_blocks_of_quick_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = {page for page in docpages.PAGES if has(page, "thorough")} | {*LONG, BRIDGES}
    run(sorted({*docpages.PAGES} - slow), ("",), tmp_path, monkeypatch)


def test_train_with_torch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch", reason='PyTorch: pip install "clplen[torch]"')
    pytest.importorskip("jax", reason='JAX: pip install "clplen[jax]"')
    run([BRIDGES], ("", "thorough"), tmp_path, monkeypatch)


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # imageio-ffmpeg keeps pipes
@pytest.mark.thorough
def test_the_blocks_of_long_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pages = [page for page in docpages.PAGES if page in LONG or has(page, "thorough")]
    pages = [page for page in pages if page != BRIDGES]
    run(pages, ("", "thorough"), tmp_path, monkeypatch)


@pytest.mark.nightly
def test_the_blocks_of_minutes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pages = [page for page in docpages.PAGES if has(page, "nightly")]
    run(pages, ("", "thorough", "nightly"), tmp_path, monkeypatch)


def test_blocks_say_why_they_do_not_run():
    """Marks are few, and code stands in fences, where it is found."""
    left_out = []
    for page in docpages.PAGES:
        text = (docpages.ROOT / page).read_text(encoding="utf-8")
        assert not re.findall(r"^    (?:clplen |import |from \w+ import ).*", text, re.MULTILINE)
        left_out += [block for block in docpages.blocks(page) if block.mark == "not run"]
    assert len(left_out) == 17, left_out
