"""``clplen view``: what becomes of files of each kind, and what wrong input is told."""

from __future__ import annotations

import json
import re
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from command_line import invoke as run

import clplen
from clplen.io import read_picture, write_depth, write_pfm, write_volume
from clplen.viewer.file_items import option_arguments

RNG = np.random.default_rng(9)
VIEWS = RNG.integers(0, 256, (3, 5, 24, 31), np.uint8)


def good(*words: object) -> str:
    done = run(*words)
    assert done.exit_code == 0, done.output
    return done.output


def items(page: Path) -> list[dict]:
    text = page.read_text(encoding="utf-8")
    (found,) = re.findall(r'id="clplen-content">(.*?)</script>', text)
    return json.loads(found)["items"]


@pytest.fixture
def light_field() -> clplen.LightField:
    return clplen.LightField.from_array(VIEWS, spacing=(-1e-4, -1e-4, 2e-5, 2e-5))


def test_a_folder_of_views(tmp_path):
    folder = tmp_path / "my views"
    folder.mkdir()
    for v in range(3):
        for u in range(5):
            imageio.imwrite(folder / f"a_{u}_{v}.png", VIEWS[v, u])
    page = tmp_path / "page.html"
    said = good("view", folder, "--pattern", "a_{u}_{v}.png", "-o", page)
    assert re.search(r"page.html: 15 views, 0\.\d MB; it opens in any browser", said)
    (item,) = items(page)
    assert item["shape"] == [3, 5, 24, 31]
    assert item["command"] == {"input": str(folder), "options": ["--pattern", "a_{u}_{v}.png"]}
    assert item["python"] == (
        f"lf = clplen.read_lightfield({str(folder)!r}, pattern='a_{{u}}_{{v}}.png')"
    )
    assert item["depth"]["disparity"]["shape"] == [24, 31]


def test_words_of_layout_as_they_were_typed():
    words = {"views": (3, 5), "swap_uv": True, "devignette": False, "white": Path("w.tif")}
    assert option_arguments(words) == [
        "--views", "3", "5", "--swap-uv", "--no-devignette", "--white", "w.tif",
    ]  # fmt: skip


def test_stacks_volumes_maps_and_pictures(tmp_path, light_field):
    stack = clplen.focal_stack(light_field, alphas=[0.9, 1.0, 1.2])
    stack.save(tmp_path / "stack.tif")
    write_volume(
        tmp_path / "volume.tif", RNG.random((4, 9, 11)), planes=[0, 1e-6, 2e-6, 3e-6],
        voxel=(5e-7, 6e-7),
    )  # fmt: skip
    depth = clplen.depth_map(stack)
    write_depth(tmp_path / "depth.ome.tif", depth)
    write_pfm(tmp_path / "map.pfm", depth.disparity)
    np.save(tmp_path / "array.npy", RNG.random((4, 9, 11)))
    imageio.imwrite(tmp_path / "picture.png", VIEWS[0, 0])
    tifffile.imwrite(tmp_path / "pages.tif", RNG.random((3, 9, 11)), photometric="minisblack")
    names = ("stack.tif", "volume.tif", "depth.ome.tif", "map.pfm", "array.npy", "picture.png",
             "pages.tif")  # fmt: skip
    page = tmp_path / "page.html"
    good("view", *(tmp_path / name for name in names), "-o", page)
    shown = dict(zip(names, items(page), strict=True))
    assert {name: item["shape"] for name, item in shown.items()} == {
        "stack.tif": [1, 3, 24, 31],
        "volume.tif": [1, 4, 9, 11],
        "depth.ome.tif": [1, 1, 24, 31],
        "map.pfm": [1, 1, 24, 31],
        "array.npy": [1, 4, 9, 11],
        "picture.png": [1, 1, 24, 31],
        "pages.tif": [1, 3, 9, 11],
    }
    assert shown["stack.tif"]["planes"]["values"] == pytest.approx([0.9, 1.0, 1.2])
    assert shown["volume.tif"]["spacing"] == pytest.approx([1e-6, 5e-7, 6e-7])
    assert shown["volume.tif"]["planes"]["unit"] == "m"
    assert shown["map.pfm"]["shown"]["table"] == "viridis"
    assert shown["picture.png"]["shown"]["white"] == 255


def test_an_ome_tiff_of_several_times(tmp_path):
    values = RNG.random((2, 3, 9, 11)).astype(np.float32)
    tifffile.imwrite(tmp_path / "series.ome.tif", values, metadata={"axes": "TZYX"})
    good("view", tmp_path / "series.ome.tif", "-o", tmp_path / "page.html")
    assert items(tmp_path / "page.html")[0]["shape"] == [2, 3, 9, 11]


UM = {
    "PhysicalSizeZ": 2.0, "PhysicalSizeY": 0.4, "PhysicalSizeX": 0.5, "PhysicalSizeZUnit": "µm",
    "PhysicalSizeYUnit": "µm", "PhysicalSizeXUnit": "µm",
}  # fmt: skip


def test_tracks_over_a_series(tmp_path):
    series, page = tmp_path / "series.ome.tif", tmp_path / "page.html"
    values = RNG.random((3, 4, 10, 12)).astype(np.float32)
    tifffile.imwrite(series, values, metadata={"axes": "TZYX", **UM})
    index = np.array([(1.0, 2, 3), (1.5, 3, 5), (3, 9, 11)])
    tracks = clplen.microscopy.Tracks(
        np.array([0, 0, 1]), np.array([0, 1, 2]), index * (2e-6, 4e-7, 5e-7), np.ones(3),
        np.ones(3), "m",
    )  # fmt: skip
    tracks.to_csv(tmp_path / "tracks.csv")
    good("view", series, "--tracks", tmp_path / "tracks.csv", "-o", page)
    (item,) = items(page)
    assert item["shape"] == [3, 4, 10, 12]
    assert item["spacing"] == pytest.approx([2e-6, 4e-7, 5e-7])
    assert item["planes"]["values"] == pytest.approx([0, 2e-6, 4e-6, 6e-6])
    assert item["python"] == f"data = clplen.io.open_volumes({str(series)!r})"
    marks = item["tracks"]
    assert (marks["ids"], marks["frames"]) == ([0, 0, 1], [0, 1, 2])
    assert np.column_stack([marks[axis] for axis in "zyx"]) == pytest.approx(index)
    good("view", series, "--tracks", tmp_path / "tracks.csv", "-o", page, "--downscale", 2)
    marks = items(page)[0]["tracks"]
    assert marks["y"] == pytest.approx((index[:, 1] - 0.5) / 2)  # 0 and 1 become pixel 0
    assert marks["z"] == pytest.approx(index[:, 0])
    tifffile.imwrite(tmp_path / "bare.ome.tif", values, metadata={"axes": "TZYX"})
    bare = ("view", tmp_path / "bare.ome.tif", "--tracks", tmp_path / "tracks.csv", "-o", page)
    assert "need the z of planes and the voxel size" in run(*bare).output
    (tmp_path / "voxels.csv").write_text(
        "track,frame,z_voxel,y_voxel,x_voxel,peak,snr\n0,0,1,1,1,1,1\n"
    )
    done = run("view", series, "--tracks", tmp_path / "voxels.csv", "-o", page)
    assert "positions in voxels" in done.output
    assert done.exit_code == 1


def test_a_series_in_ome_zarr(tmp_path):
    zarr = pytest.importorskip("zarr")
    values = RNG.random((3, 1, 4, 9, 11)).astype(np.float32)
    group = zarr.open_group(tmp_path / "s.ome.zarr", mode="w", zarr_format=2)
    group.create_array("0", shape=values.shape, dtype="<f4", chunks=(1, 1, 1, 9, 11))[...] = values
    axes = [{"name": name} for name in "tczyx"]
    moves = [{"type": "scale", "scale": [1.0] * 5}]
    group.attrs["multiscales"] = [
        {"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": moves}]}
    ]
    good("view", tmp_path / "s.ome.zarr", "-o", tmp_path / "page.html")
    assert items(tmp_path / "page.html")[0]["shape"] == [3, 4, 9, 11]


def test_volumes_as_the_times_of_one_series(tmp_path):
    for n in range(3):
        np.save(tmp_path / f"{n}.npy", (n + 1) * RNG.random((4, 9, 11)))
    files = [tmp_path / f"{n}.npy" for n in range(3)]
    good("view", *files, "--time", "-o", tmp_path / "page.html")
    (item,) = items(tmp_path / "page.html")
    assert item["shape"] == [3, 4, 9, 11]
    assert len(item["samples"]["levels"]) == 3
    assert item["shown"]["range"][1] > 2.5
    np.save(tmp_path / "other.npy", RNG.random((4, 9, 12)))
    done = run("view", *files, tmp_path / "other.npy", "--time", "-o", tmp_path / "b.html")
    assert done.exit_code == 2
    assert "of equal size" in done.output


def test_maps_compared_with_their_truth(tmp_path):
    truth = RNG.random((50, 60)).astype(np.float32)
    write_pfm(tmp_path / "truth.pfm", truth)
    write_pfm(tmp_path / "good.pfm", truth + 0.01)
    write_pfm(tmp_path / "bad.pfm", truth + 0.5)
    files = [tmp_path / "good.pfm", tmp_path / "bad.pfm"]
    page = tmp_path / "page.html"
    good("view", *files, "--compare", "--truth", tmp_path / "truth.pfm", "-o", page)
    text = page.read_text()
    scores = json.loads(re.findall(r'id="clplen-content">(.*?)</script>', text)[0])["scores"]
    assert scores["rows"][0][:3] == ["good", "0.01", "0"]
    assert scores["rows"][1][:3] == ["bad", "25", "100"]


def test_fewer_views_and_pixels(tmp_path, light_field):
    clplen.write_lightfield(tmp_path / "lf.h5", light_field)
    page = tmp_path / "page.html"
    words = ("--most-views", 1, 3, "--downscale", 2, "--quality", 80, "--no-depth")
    good("view", tmp_path / "lf.h5", "-o", page, *words)
    (item,) = items(page)
    assert item["shape"] == [1, 3, 12, 15]
    assert item["depth"] is None
    assert item["full"] == {"views": [3, 5], "first": [1, 1], "downscale": 2}


def test_a_depth_map_from_a_file(tmp_path, light_field):
    clplen.write_lightfield(tmp_path / "lf.h5", light_field)
    write_pfm(tmp_path / "d.pfm", np.full((24, 31), 0.5, np.float32))
    page = tmp_path / "page.html"
    good("view", tmp_path / "lf.h5", "--depth-map", tmp_path / "d.pfm", "-o", page)
    assert items(page)[0]["depth"]["file"] == str(tmp_path / "d.pfm")
    write_pfm(tmp_path / "d.pfm", np.zeros((24, 30), np.float32))
    done = run("view", tmp_path / "lf.h5", "--depth-map", tmp_path / "d.pfm", "-o", page, "--force")
    assert done.exit_code == 1
    assert "24 x 30 pixels (y, x), the views have 24 x 31" in done.output


WRONG = [
    (["missing.png"], "The file or folder missing.png does not exist"),
    (["text.txt"], "is not a supported light field"),
    (["empty.png"], "empty"),
    (["cut.png"], "cut.png"),
    (["lf.npy", "-o", "page.png"], "end in .html"),
    (["lf.npy", "-o", "none/page.html"], "none"),
    (["lf.npy", "--compare"], "at least two inputs, got 1"),
    (["lf.npy", "lf.npy", "--time", "--compare"], "cannot be combined"),
    (["lf.npy", "--truth", "x.pfm"], "--truth needs --compare"),
    (["lf.npy", "-o", "page.html", "--port", "8080"], "--port applies to a served page"),
    (["lf.npy", "--downscale", "99", "-o", "page.html"], "pixels of a view, got 99"),
    (["nan.npy", "-o", "page.html"], "NaN"),
    ([], "INPUT"),
]


def test_wrong_input_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("text.txt").write_text("hello")
    Path("empty.png").touch()
    Path("folder").mkdir()
    imageio.imwrite("whole.png", VIEWS[0, 0])
    Path("cut.png").write_bytes(Path("whole.png").read_bytes()[:200])
    np.save("lf.npy", VIEWS)
    np.save("nan.npy", np.where(VIEWS > 250, np.nan, VIEWS))
    before = {file.name for file in tmp_path.iterdir()}
    for words, sentence in WRONG:
        done = run("view", *words)
        assert done.exit_code in (1, 2), done.output
        assert sentence in " ".join(done.output.split())
        assert "Traceback" not in done.output
        assert {file.name for file in tmp_path.iterdir()} == before


def test_a_page_is_replaced_only_if_it_is_ours(tmp_path):
    np.save(tmp_path / "lf.npy", VIEWS)
    page = tmp_path / "page.html"
    page.write_text("<p>mine</p>")
    good("view", tmp_path / "lf.npy", "-o", page, "--force", "--no-depth")
    good("view", tmp_path / "lf.npy", "-o", page, "--no-depth")


def test_limits_and_curves_of_pictures(tmp_path):
    for words, level in [
        (["--limits", "0:255"], lambda t: t),
        (["--limits", "51:153"], lambda t: np.clip((t - 0.2) / 0.4, 0, 1)),
        (["--limits", "0:255", "--curve", "2"], lambda t: t**0.5),
        (["--curve", "log"], lambda t: np.log10(1 + 999 * t) / 3),
    ]:
        np.save(tmp_path / "lf.npy", VIEWS)
        for command in ("refocus", "render"):
            picture = tmp_path / "picture.png"
            good(command, tmp_path / "lf.npy", "--disparity", 0.0, "-o", picture, *words)
            mean = VIEWS.mean((0, 1)) / 255
            assert np.abs(read_picture(picture) - 255 * level(mean)).max() <= 0.51


def test_limits_and_curves_that_are_none(tmp_path, monkeypatch):
    for words, sentence in [
        (["--limits", "5:5", "-o", "a.png"], "not BLACK:WHITE"),
        (["--limits", "5", "-o", "a.png"], "not BLACK:WHITE"),
        (["--limits", "nan:1", "-o", "a.png"], "not BLACK:WHITE"),
        (["--curve", "0", "-o", "a.png"], "is not a curve"),
        (["--curve", "sine", "-o", "a.png"], "is not a curve"),
        (["--limits", "0:1", "-o", "a.tif"], "holds linear values"),
        (["--depth-map", "d.pfm", "-o", "a.png"], "Give one of"),
    ]:
        monkeypatch.chdir(tmp_path)
        np.save("lf.npy", VIEWS)
        done = run("refocus", "lf.npy", "--disparity", "0", *words)
        assert done.exit_code == 2
        assert sentence in " ".join(done.output.split())
        assert not Path("a.png").exists()


def test_a_map_with_holes_is_refused_and_one_without_is_taken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("lf.npy", VIEWS)
    d = np.full((24, 31), 0.5, np.float32)
    write_pfm("d.pfm", d)
    for words in (["refocus"], ["render", "--viewpoint", "1.5", "2.25"]):
        good(words[0], "lf.npy", *words[1:], "--depth-map", "d.pfm", "-o", "a.tif")
        lf = clplen.LightField.from_array(VIEWS)
        whole = words[0] == "refocus"
        wanted = lf.flatten(disparity=d) if whole else lf.view(1.5, 2.25, disparity=d)
        made = clplen.io.read_image("a.tif").to_numpy()
        assert np.abs(made - wanted.to_numpy()).max() < 1e-4
    d[3, 4] = np.nan
    write_pfm("d.pfm", d)
    done = run("refocus", "lf.npy", "--depth-map", "d.pfm", "-o", "b.tif")
    assert "no disparity at 1 pixels" in done.output
