"""Figures: what is drawn, in which units, and that no display is needed."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import imageio.v3 as imageio
import numpy as np
import pytest

from clplen import plot
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.standard_camera import Plenoptic1
from clplen.compute.arrays import Image
from clplen.compute.device import Device
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.plot.base import new_figure, spread, verbatim
from clplen.wave.elements.lenslets import MicrolensArray

SHAPE = (4, 5, 7, 9)


def camera(device: Device) -> Plenoptic1:
    return PlenopticCamera.type1(
        focal_length=0.1,
        mla=MicrolensArray(150e-6, 10e-3, count=31, fill="full"),
        wavelength=532e-9,
        pixels_per_lenslet=30,
        device=device,
    )


def light_field(device: Device, colours: int = 0) -> LightField:
    values = np.random.default_rng(1).random(SHAPE + (colours,) * bool(colours), np.float32)
    return LightField.from_array(
        values, device=device, spacing=(-1e-4, -2e-4, 1.5e-4, 1.5e-4), camera=camera(device)
    )


def stack(device: Device, shape: tuple[int, ...], alphas: bool = True) -> FocalStack:
    values = np.random.default_rng(1).random(shape, np.float32)
    d = np.linspace(-1, 1, shape[0])
    return FocalStack(device.upload(values), device, d, 1 - d / 4 if alphas else d * np.nan)


def image_axes(figure):
    return [axes for axes in figure.axes if axes.images]


def test_saved_whole_as_png(tmp_path: Path, device: Device):
    image = Image(device.upload(np.eye(5, 7, dtype=np.float32)), device)
    plot.save(plot.picture(image, title="eye"), tmp_path / "eye.png", dpi=50)
    assert imageio.imread(tmp_path / "eye.png").shape[2] == 4
    assert list(tmp_path.iterdir()) == [tmp_path / "eye.png"]
    plot.save(plot.picture(image), tmp_path / "big.png", dpi=100)
    small, big = (imageio.imread(tmp_path / f"{name}.png").shape for name in ("eye", "big"))
    assert abs(big[0] - 2 * small[0]) <= 1


def test_the_raw_image_is_drawn_in_millimetres(device: Device):
    cam = camera(device)
    values = np.random.default_rng(1).random(cam.grid.shape, np.float32)
    grid = SimpleNamespace(
        first=(14.5, 14.5), row_step=(30, 0), column_step=(0, 30), count=(31, 31)
    )
    raw = RawImage(device.upload(values), device, 5e-6, grid, grid)
    figure = plot.raw_image(raw, details={"P": (1e-3, -0.5e-3)})
    whole, detail = image_axes(figure)
    assert whole.images[0].get_extent() == pytest.approx([-2.325, 2.325, 2.325, -2.325])
    assert detail.get_xlim() == pytest.approx((-0.5 - 0.675, -0.5 + 0.675))
    assert detail.get_ylim() == pytest.approx((1 + 0.675, 1 - 0.675))
    assert whole.get_xlabel() == "x on the sensor / mm"
    borders = sorted(line.get_xdata()[0] for line in detail.lines if line.get_ydata()[1] == 1)
    every = (np.arange(32) * 30 - 465) * 5e-3
    np.testing.assert_allclose(borders, every[np.abs(every + 0.5) < 0.675], atol=1e-12)
    drawn = np.asarray(detail.images[0].get_array())
    left, right, bottom, top = detail.images[0].get_extent()
    assert ((right - left) / 5e-3, (bottom - top) / 5e-3) == pytest.approx(drawn.shape[::-1])
    row, column = 465 + 200 - 1, 465 - 100  # pixel centres at -0.4975 and 0.9975 mm
    at = (int((0.9975 - top) / 5e-3), int((-0.4975 - left) / 5e-3))
    assert drawn[at] == values[row, column]
    assert any("logarithmic" in axes.get_ylabel() for axes in figure.axes)


def test_a_large_raw_image_is_averaged_for_display(device: Device):
    values = np.random.default_rng(1).random((2005, 3001), np.float32)
    grid = SimpleNamespace()
    raw = RawImage(device.upload(values), device, 2e-6, grid, grid)
    shown = image_axes(plot.raw_image(raw))[0].images[0]
    np.testing.assert_allclose(shown.get_array()[5, 7], values[15:18, 21:24].mean(), rtol=1e-6)
    assert shown.get_extent() == pytest.approx([-3.001, 2.999, 2.003, -2.005])


def test_views_keep_their_order(device: Device):
    lf = light_field(device)
    axes = image_axes(plot.views(lf, max_views=3))[0]
    drawn = np.asarray(axes.images[0].get_array())
    values = lf.to_numpy()
    assert drawn.shape == (2 * 7, 3 * 9)
    np.testing.assert_array_equal(drawn[7:14, 18:27], values[3, 4])
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0", "2", "4"]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["0", "3"]
    assert axes.get_title() == "views: 2 x 3 of 4 x 5"
    part = plot.views(lf, max_views=3, region=(slice(1, 4), slice(2, 9)))
    drawn = np.asarray(image_axes(part)[0].images[0].get_array())
    np.testing.assert_array_equal(drawn[:3, :7], values[0, 0, 1:4, 2:])


def test_what_is_shown_of_many_is_even_and_symmetric():
    for shown in [1, 5, 6, 15]:
        for count in range(1, 40):
            chosen = spread(count, shown)
            assert 0 < len(chosen) <= shown
            assert len(set(np.diff(chosen))) <= 1
            if shown > 1 or count % 2:
                assert chosen == [count - 1 - index for index in reversed(chosen)]
            if len(chosen) > 1:
                assert chosen[0] < chosen[1] - chosen[0]  # nothing more would fit


def test_colours_are_linear_and_have_no_bar(device: Device):
    figure = plot.views(light_field(device, 3))
    assert len(figure.axes) == 1
    values = np.asarray(figure.axes[0].images[0].get_array())
    lf = light_field(device, 3).to_numpy()
    np.testing.assert_allclose(values[:7, :9], lf[0, 0] / lf.max(), rtol=1e-6)


def test_refocused_pictures_share_one_scale(device: Device):
    images = [Image(device.upload(np.full((6, 8), k, np.float32)), device) for k in (1, 3)]
    figure = plot.refocused(images, ["a", "b"], region=(slice(1, 5), slice(2, 8)))
    axes = image_axes(figure)
    assert [panel.images[0].norm.vmax for panel in axes] == [3, 3]
    assert axes[0].images[0].get_extent() == pytest.approx((1.5, 7.5, 4.5, 0.5))
    assert [panel.get_title() for panel in axes] == ["a", "b"]


def test_a_scale_that_is_not_linear_is_said(device: Device):
    for scale, word in [("log", "logarithmic"), ("root", "square root")]:
        figure = plot.montage(stack(device, (5, 6, 8)), scale=scale)
        assert any(word in axes.get_ylabel() for axes in figure.axes)


def test_arrows_only_where_something_lies_beyond(device: Device):
    for lowest, arrow in ((0.5, "neither"), (1e-6, "min")):
        values = np.ones((6, 8), np.float32)
        values[2, 3] = lowest
        image = Image(device.upload(values), device)
        one, several = plot.picture(image, scale="log"), plot.refocused([image], [""], scale="log")
        for figure in (one, several):
            assert image_axes(figure)[0].images[0].colorbar.extend == arrow


def test_the_montage_names_its_planes(device: Device):
    titles = [
        axes.get_title()
        for axes in image_axes(plot.montage(stack(device, (7, 6, 8, 3)), max_planes=3))
    ]
    assert titles == [r"$\alpha$ = 1.250", r"$\alpha$ = 1.000", r"$\alpha$ = 0.750"]
    figure = plot.montage(stack(device, (2, 6, 8), alphas=False))
    assert [axes.get_title() for axes in image_axes(figure)] == ["d = -1.000", "d = +1.000"]


def test_the_phase_space_is_in_metres_with_u_upwards(device: Device):
    lf = light_field(device)
    values = np.zeros(SHAPE, np.float32)
    values[:, 0, 3, 7] = 1.0  # u index 0 is at +0.4 mm, since du < 0
    lf = replace(lf, data=device.upload(values))
    figure = plot.phase_space(lf, rows=[3], labels=["a"], truths=[0.75])
    axes = image_axes(figure)[0]
    drawn = np.asarray(axes.images[0].get_array())
    left, right, bottom, top = axes.images[0].get_extent()
    assert (left, right) == pytest.approx((-0.675, 0.675))
    assert (bottom, top) == pytest.approx((-0.5, 0.5))
    assert np.unravel_index(drawn.argmax(), drawn.shape) == (0, 7)  # the uppermost row
    line = axes.lines[0]
    slope = np.diff(line.get_xdata()[[0, -1]]) / np.diff(line.get_ydata()[[0, -1]])
    assert slope == pytest.approx(0.25)
    assert axes.get_ylabel() == "u on the main lens / mm"
    with pytest.raises(ValueError, match="spacing in metres"):
        plot.phase_space(replace(lf, spacing=None), rows=[1], labels=["a"])


def test_estimates_lie_on_the_curve(device: Device):
    cam = camera(device)
    figure = plot.alpha_curve(cam, {"exact": [(-0.02, cam.alpha(-0.02)), (0.03, 1.2)]}, reach=0.05)
    upper, lower = figure.axes
    curve = upper.lines[0]
    np.testing.assert_allclose(curve.get_ydata(), cam.alpha(curve.get_xdata() * 1e-3), rtol=1e-12)
    np.testing.assert_allclose(upper.lines[1].get_xdata(), [-20, 30])
    errors = next(line for line in lower.lines if line.get_marker() == "s").get_ydata()
    np.testing.assert_allclose(errors, [0, 1.2 - cam.alpha(0.03)], atol=1e-12)


def test_curves_are_divided_by_their_maximum(device: Device):
    alphas = np.linspace(0.7, 1.3, 13)
    found = SimpleNamespace(alpha=0.9, curve=(alphas, 5 * np.exp(-((alphas - 0.9) ** 2) / 0.01)))
    panel = plot.energy_curves({"m": [("-50 mm", found, 0.88)]}).axes[0]
    assert panel.lines[0].get_ydata().max() == pytest.approx(1)
    assert panel.lines[1].get_xdata()[0] == 0.88
    assert panel.lines[2].get_xdata()[0] == 0.9


def test_depth_has_units_and_says_what_it_cuts():
    values = np.random.default_rng(1).normal(size=(20, 30)).astype(np.float32)
    values[0, 0] = 50
    confidence = np.full_like(values, 0.5)
    figure = plot.depth(SimpleNamespace(disparity=values, confidence=confidence))
    left, right = image_axes(figure)
    np.testing.assert_array_equal(left.images[0].get_array(), values)
    assert left.images[0].norm.vmax < 5
    assert left.images[0].colorbar.extend == "both"
    assert not left.texts
    assert (left.images[0].get_alpha() == 1).all()
    assert not figure.get_supxlabel()
    assert "disparity / pixel per view step" in left.images[0].colorbar.ax.get_ylabel()
    assert (right.images[0].norm.vmin, right.images[0].norm.vmax) == (0, 1)


def test_names_are_drawn_as_they_are():
    """Two dollar signs begin no formula."""
    name = "_a$5_$9^\\$\udcff\n\u202e"
    values = np.eye(4, 5)
    figure = plot.magnification(values, values, title=f"m of {verbatim(name)}")
    assert plot.rendered(figure, dpi=40).shape[2] == 3
    drawn = figure.axes[0].get_title().replace(r"\$", "$")
    assert drawn.endswith("a$5_$9^\\$\\udcff\\n\\u202e")
    figure = new_figure(9, 4)
    axes = figure.add_subplot()
    axes.plot([1, 2], label=verbatim(name))
    assert len(axes.legend().get_texts()) == 1  # matplotlib leaves out what begins with _
    plot.rendered(figure, dpi=40)


def test_depth_without_texture_says_so():
    nothing = np.zeros((20, 30), np.float32)
    figure = plot.depth(SimpleNamespace(disparity=nothing - 1.13, confidence=nothing + 1e-7))
    left = image_axes(figure)[0]
    assert "nothing to tell depth by" in left.texts[0].get_text()
    assert left.images[0].colorbar is None


def test_every_measured_pixel_sets_the_colours_of_depth():
    confidence = np.full((20, 30), 0.9, np.float32)
    confidence[:, 14:] = 0.2  # both halves count, though one is surer
    confidence[:3] = 0
    disparity = np.where(np.arange(30) < 14, -0.5, 0.5) * np.ones((20, 1))
    disparity[:3] = 7
    disparity[3, 4] = np.nan
    disparity[4, :2] = 3  # of 510 pixels, below 2 %
    figure = plot.depth(SimpleNamespace(disparity=disparity, confidence=confidence))
    drawn = image_axes(figure)[0].images[0]
    assert (drawn.norm.vmin, drawn.norm.vmax) == (-0.5, 0.5)
    assert drawn.colorbar.extend == "max"
    alpha = drawn.get_alpha()
    assert alpha[0, 0] == pytest.approx(0.35)
    assert alpha[5, 20] == pytest.approx(0.35 + 0.65 * 0.4)  # 0.2 of 0.5
    assert (alpha[3:, :14] == 1).all()
    assert "pale: confidence below 0.5" in figure.get_supxlabel()


def test_neither_a_display_nor_pyplot_is_needed():
    code = "import sys, clplen.plot; sys.exit('matplotlib.pyplot' in sys.modules)"
    environment = os.environ | {"PYTHONPATH": str(Path(plot.__file__).parents[2])}
    assert subprocess.run([sys.executable, "-c", code], env=environment).returncode == 0
