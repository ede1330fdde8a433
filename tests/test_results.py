"""Results at a prompt: saved, drawn, shown in a notebook."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import objects
import pytest
from objects import EXAMPLES, samples
from public_names import public_classes

import clplen
from clplen.compute.device import Device
from clplen.results import Plottable, Savable

PNG = b"\x89PNG"
SAVED = {
    "DeconvolutionResult",
    "DepthMap",
    "FocalStack",
    "FocusedImage",
    "FocusedStack",
    "Image",
    "LightField",
    "OPDMaps",
    "RawImage",
    "Truth",
}
# Ending of a file that keeps everything, and what reads the same values back.
PAIRS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "DepthMap": ("d.ome.tif", lambda path: clplen.io.read_depth(path)),
    "FocalStack": ("s.tif", lambda path: clplen.io.read_stack(path)),
    "FocusedImage": ("f.tif", lambda path: clplen.io.read_image(path)),
    "Image": ("i.tif", lambda path: clplen.io.read_image(path)),
    "LightField": ("l.h5", lambda path: clplen.read_lightfield(path)),
    "RawImage": ("r.h5", lambda path: clplen.read_raw(path)),
    "Truth": ("t.h5", lambda path: clplen.io.read_scene_truth(path)),
}
PARAMETERS = {"na": 0.5, "medium_index": 1.0, "wavelength": 525e-9}
PLANES = np.array([-1e-6, 1e-6])


def kinds(base: type) -> set[str]:
    """Return the names of the public classes with a base."""
    classes = public_classes().items()
    return {name.rpartition(".")[2] for name, kind in classes if issubclass(kind, base)}


def volume(*lead: int, **known: Any) -> Any:
    return clplen.microscopy.DeconvolutionResult(
        samples(*lead, 2, 9, 9), samples(*lead, 3), 3, (), **known
    )


def microscope_images() -> Any:
    return replace(
        objects.point_images(), parameters=objects.point_images().parameters | PARAMETERS
    )


def test_every_savable_class_is_in_the_list() -> None:
    assert kinds(Savable) == SAVED


def test_what_is_saved_is_read_again(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLPLEN_DEVICE", device.place)
    for name in SAVED - {"LightField"}:
        result = EXAMPLES[name](device)
        if name in PAIRS:
            ending, read = PAIRS[name]
            result.save(tmp_path / ending)
            back = read(tmp_path / ending)
            np.testing.assert_array_equal(np.asarray(back), np.asarray(result), name)
        with pytest.raises(ValueError, match=r"must end|written|no voxel positions") as error:
            result.save(tmp_path / "x.xyz")
        assert "\n" not in str(error.value)


def test_saving_takes_the_options_of_the_writer(device: Device, tmp_path: Path) -> None:
    stack = EXAMPLES["FocalStack"](device)
    stack.save(tmp_path / "s.tif", progress=False, durable=True)
    EXAMPLES["DepthMap"](device).save(tmp_path / "d.ome.tif", spacing=objects.SPACING)
    with pytest.raises(TypeError, match="dpi"):
        stack.save(tmp_path / "s.tif", dpi=3)


def test_volumes_know_their_voxels(tmp_path: Path, device: Device) -> None:
    result = volume(planes=PLANES, voxel=(2e-6, 2e-6))
    result.save(tmp_path / "v.tif")
    values, about = clplen.io.read_volume(tmp_path / "v.tif")
    np.testing.assert_array_equal(values, result.volume)
    assert about["planes_um"] == [-1.0, 1.0]
    with pytest.raises(ValueError, match="give planes="):
        volume().save(tmp_path / "w.tif")
    volume().save(tmp_path / "w.tif", planes=PLANES, voxel=(1e-6, 1e-6))
    with pytest.raises(clplen.ShapeError, match="A volume must have shape"):
        volume(3, planes=PLANES, voxel=(2e-6, 2e-6)).save(tmp_path / "x.tif")
    projector = clplen.Projector(microscope_images(), (5, 5), device=device)
    found = clplen.deconvolve(samples(15, 15), projector, iterations=1)
    np.testing.assert_array_equal(found.planes, projector.images.planes)
    assert found.voxel == (projector.images.side,) * 2


def test_plots_are_figures_and_pictures_of_notebooks(device: Device) -> None:
    from matplotlib.figure import Figure

    result = EXAMPLES["LightField"](device)
    assert isinstance(result.plot(), Figure)
    assert result._repr_png_().startswith(PNG)


@pytest.mark.thorough
def test_every_plottable_class_is_drawn(device: Device) -> None:
    for name in sorted(kinds(Plottable)):
        assert EXAMPLES[name](device)._repr_png_().startswith(PNG), name


def maps(*values: Any) -> clplen.DepthMap:
    return clplen.DepthMap(*(np.full((16, 16), value, np.float32) for value in values))


def image(values: Any) -> Callable[[Device], Any]:
    array = np.ascontiguousarray(values, np.float32)
    return lambda device: clplen.Image(device.upload(array), device)


def colours(device: Device) -> clplen.LightField:
    return clplen.LightField.from_array(samples(3, 3, 32, 32, 3), device=device)


ODD: dict[str, Callable[[Device], Any]] = {
    "all NaN": image(np.full((9, 9), np.nan)),
    "some NaN": image(np.where(np.eye(9), np.nan, 1)),
    "flat": image(np.ones((9, 9))),
    "dark": image(np.zeros((9, 9))),
    "below zero": image(-np.ones((9, 9))),
    "infinite": image(np.where(np.eye(9), np.inf, 1)),
    "colours": lambda device: colours(device).view(1, 1),
    "dark colours": image(np.zeros((9, 9, 3))),
    "one row": image(np.ones((1, 9))),
    "one pixel": image(np.ones((1, 1))),
    "colour views": colours,
    "colour stack": lambda device: clplen.focal_stack(colours(device), disparities=[0, 1]),
    "one plane": lambda device: clplen.focal_stack(colours(device), disparities=[0]),
    "unknown depth": lambda device: maps(np.nan, np.nan, np.nan, 0),
    "unknown confidence": lambda device: maps(1, np.nan, np.nan, np.nan),
    "flat depth": lambda device: maps(1, np.nan, np.nan, 1),
    "empty scene": lambda device: clplen.cameras.Truth(
        *(np.full((9, 9), np.nan, np.float32),) * 2, np.full((9, 9), -1, np.int32), {}
    ),
    "one plane of voxels": lambda device: clplen.microscopy.DeconvolutionResult(
        samples(1, 9, 9), samples(3), 3, ()
    ),
    "volume with lengths": lambda device: volume(planes=PLANES, voxel=(1e-6, 1e-6)),
    "batch of fields": lambda device: clplen.Field.from_array(
        np.ones((3, 8, 8)), objects.GRID, wavelength=objects.LAM, device=device
    ),
    "dark field": lambda device: clplen.Field.from_array(
        np.zeros((8, 8)), objects.GRID, wavelength=objects.LAM, device=device
    ),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("first", [0, pytest.param(1, marks=pytest.mark.thorough)])
def test_unusual_results_are_drawn(first: int, device: Device) -> None:
    for name, make in list(ODD.items())[first :: 3 if first == 0 else 1]:
        assert make(device)._repr_png_().startswith(PNG), name


def test_figures_are_pictures_in_a_notebook(device: Device) -> None:
    figure = clplen.plot.intensity(EXAMPLES["Field"](device))
    assert figure._repr_png_().startswith(PNG)
    assert clplen.plot.psf(EXAMPLES["PSF"](device))._repr_png_().startswith(PNG)


def test_what_cannot_be_drawn_is_left_to_the_text(device: Device) -> None:
    for result in (image(samples(9, 9, 2))(device), volume(3)):
        assert result._repr_png_() is None
        with pytest.raises(clplen.ShapeError):
            result.plot()


def test_cameras_are_tables_in_a_notebook(device: Device) -> None:
    for name in ("PlenopticCamera", "Plenoptic2", "Microscope"):
        camera = EXAMPLES[name](device)
        table = camera._repr_html_()
        assert table.startswith("<table>")
        assert table.count("<tr>") == len(camera.describe().rows)
        assert "</caption><tr><td>" in table
