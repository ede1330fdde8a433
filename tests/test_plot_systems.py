"""Side views of optical systems: rays by closed forms, sizes, words."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb

from clplen import MicrolensArray, PlenopticCamera, plot
from clplen.plot.rays import rays_through, trace
from clplen.wave.systems.components import Element, Lens, Stop
from clplen.wave.systems.optical_system import OpticalSystem, imaging_system

ARRAY = MicrolensArray(1e-3, 6e-3, count=(5, 3), fill="full", offset=(0.2e-3, 7e-3))
PLENOPTIC = OpticalSystem([0.05, Lens(0.03, diameter=6e-3), 0.075, ARRAY, 6e-3])


def test_rays_of_an_image():
    rays = rays_through(imaging_system(0.12, diameter=3.6e-3, magnification=0.5))
    np.testing.assert_allclose(rays.z, [0, 0.36, 0.36, 0.54])
    np.testing.assert_allclose(rays.axial[:, 0], [0, -1.8e-3, -1.8e-3, 0], atol=1e-12)
    h = rays.height
    assert h == pytest.approx(0.7 * 1.8e-3)
    np.testing.assert_allclose(rays.oblique[:, -1], [h, 1.8e-3, 1.8e-3, -h / 2], atol=1e-12)
    np.testing.assert_allclose(rays.chief[:, 0], [h, 0, 0, -h / 2], atol=1e-12)
    assert [(image.z, image.height) for image in rays.images] == [pytest.approx((0.54, -h / 2))]
    larger = rays_through(imaging_system(0.12, diameter=3.6e-3, magnification=3))
    assert larger.images[0].height == pytest.approx(-0.7 * 1.8e-3)
    given = rays_through(imaging_system(0.12, diameter=3.6e-3), height=1e-3)
    assert (given.height, given.images[0].height) == pytest.approx((1e-3, -1e-3))


def test_an_image_between_two_lenses():
    # Lens law: 1/.1 - 1/.3 gives .15; the image lies .05 in front of a lens with f = .04.
    system = OpticalSystem([0.3, Lens(0.1, diameter=0.02), 0.2, Lens(0.04, diameter=0.02), 0.3])
    rays = rays_through(system, height=1e-3)
    found = [(image.z, image.height) for image in rays.images]
    assert found == [pytest.approx((0.45, -0.5e-3)), pytest.approx((0.7, 2e-3))]


def test_the_narrowest_opening_stops_the_light():
    system = OpticalSystem([0.1, Lens(0.1, diameter=20e-3), 0.1, Stop(5e-3), 0.1])
    rays = rays_through(system)
    np.testing.assert_allclose(rays.axial[3], [-2.5e-3, 2.5e-3])
    assert rays.chief[3] == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(rays.oblique[3], [-2.5e-3, 2.5e-3], atol=1e-12)
    assert rays.images == ()
    # Beside the axis the lens cuts: at the stop y = .1 slope, at the lens y = h + .1 slope.
    cut = rays_through(system, height=9e-3)
    np.testing.assert_allclose(cut.oblique[3], [-2.5e-3, 1e-3], atol=1e-12)
    assert rays_through(system, height=13e-3).oblique is None
    moved = OpticalSystem([0.1, Stop(2e-3, centre=(1.5e-3, 9.0)), 0.1])
    np.testing.assert_allclose(rays_through(moved).axial[1], [0.5e-3, 2.5e-3])


def test_lenslets_bend_towards_their_own_axes():
    _, y = trace(OpticalSystem([ARRAY, 6e-3]), np.array([-2.1, -0.7, 0.3, 1.0, 2.6, 2.8]) * 1e-3, 0)
    np.testing.assert_allclose(y[2] * 1e3, [-1.8, -0.8, 0.2, 1.2, 2.2, np.nan], atol=1e-12)
    _, tilted = trace(OpticalSystem([ARRAY, 6e-3]), 0.3e-3, 0.01)
    assert tilted[2] == pytest.approx(0.2e-3 + 0.01 * 6e-3)
    _, walled = trace(OpticalSystem([Stop(2e-3), 0.1]), [0.9e-3, 1.1e-3], 0.0)
    np.testing.assert_allclose(walled[2], [0.9e-3, np.nan])
    discs = MicrolensArray(1e-3, 6e-3, count=3, diameter=0.8e-3)
    assert np.isnan(trace(OpticalSystem([discs, 6e-3]), [0.45e-3], 0)[1][2]).all()


def test_light_on_a_first_lens_is_collimated():
    rays = rays_through(OpticalSystem([Lens(0.1, diameter=20e-3), 0.1]))
    assert rays.distant
    assert rays.height == 0
    np.testing.assert_allclose(rays.axial, [[-0.01, 0.01], [-0.01, 0.01], [0, 0]], atol=1e-12)
    assert rays.images[0].height == pytest.approx(7e-3)
    assert rays.tilt == pytest.approx(0.07)
    np.testing.assert_allclose(rays.chief[:, 0], [0, 0, 7e-3], atol=1e-12)


def words(figure) -> list[str]:
    return [text.get_text() for text in figure.axes[0].texts if text.get_text()]


def glass(figure):
    """Corners (z low, z high, y low, y high) of every lens drawn."""
    found = [c for c in figure.axes[0].collections if type(c) is PolyCollection]
    paths = [path.vertices for c in found for path in c.get_paths()]
    return [(*np.sort(p[:, 0])[[0, -1]], p[:, 1].min(), p[:, 1].max()) for p in paths]


def test_the_figure_says_what_is_where():
    figure = plot.system(imaging_system(0.12, diameter=3.6e-3, magnification=0.5))
    at = {text.get_text(): text.get_position()[0] for text in figure.axes[0].texts}
    places = {
        "object": 0, "lens\nf = 120 mm\nD = 3.6 mm": 0.36, "image": 0.54, "360 mm": 0.18,
        "180 mm": 0.45,
    }  # fmt: skip
    for word, z in places.items():
        assert at[word] == pytest.approx(z)
    dots = [line.get_xdata()[0] for line in figure.axes[0].lines if line.get_marker() == "o"]
    assert sorted(dots) == pytest.approx([0.24, 0.48])
    ((left, right, low, high),) = glass(figure)
    assert (left + right) / 2 == pytest.approx(0.36)
    assert (low, high) == pytest.approx((-1.8e-3, 1.8e-3))
    assert "last plane" not in at


def test_z_is_to_scale_and_the_heights_are_said():
    figure = plot.system(imaging_system(0.12, diameter=3.6e-3), extent=5e-3)
    axes = figure.axes[0]
    figure.draw_without_rendering()
    box = axes.get_window_extent()
    first, last = axes.get_xlim()
    assert axes.get_ylim() == pytest.approx((-2.5e-3, 2.5e-3))
    assert first < 0
    assert last > 0.48
    ratio = (box.height / 5e-3) / (box.width / (last - first))
    assert f"heights to lengths {ratio:.4g} : 1" in figure.texts[0].get_text()
    assert axes.yaxis.get_major_formatter()(1.5e-3, 0) == "1.5"
    assert axes.get_ylabel() == "y / mm"


def test_rays_of_the_figure_are_those_traced():
    figure = plot.system(PLENOPTIC, height=1e-3)
    rays = rays_through(PLENOPTIC, height=1e-3)
    for colour, expected in (("#0072b2", rays.axial), ("#cc3311", rays.oblique)):
        drawn = [
            line.get_ydata() for line in figure.axes[0].lines
            if to_rgb(line.get_color()) == to_rgb(colour) and line.get_linestyle() == "-"
        ]  # fmt: skip
        assert sorted(y[1] for y in drawn) == pytest.approx(sorted(expected[1]))
    assert len(glass(figure)) == 1 + 5
    assert glass(figure)[1][2:] == pytest.approx((-2.3e-3, -1.3e-3))


def test_walls_leave_the_opening_free():
    figure = plot.system(OpticalSystem([0.1, Stop(2e-3, centre=(1e-3, 0)), 0.1]), extent=8e-3)
    walls = [c for c in figure.axes[0].collections
             if type(c) is LineCollection and c.get_linewidth()[0] == 3]  # fmt: skip
    ends = np.sort([segment[:, 1] for c in walls for segment in c.get_segments()], axis=None)
    np.testing.assert_allclose(ends, [-4e-3, 0, 2e-3, 4e-3], atol=1e-12)


def test_words_that_would_overlap_take_another_row():
    close = OpticalSystem([
        0.1, Lens(0.1), 1e-3, Stop(1e-3), 2e-3, Element(abs, "phase mask"), 0.018,
        Element(abs, "another mask"), 0.1,
    ])  # fmt: skip
    figure = plot.system(close)
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts if text.get_text()]
    inside = figure.bbox.padded(1)
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i])
        assert inside.contains(box.x0, box.y0)
        assert inside.contains(box.x1, box.y1)
    assert {"1 mm", "2 mm", "phase mask", "last plane"} <= set(words(figure))


def test_every_system_can_be_drawn(tmp_path: Path):
    for system in [
        OpticalSystem([0.1]),
        OpticalSystem([-0.1, Lens(0.1, diameter=1e-3), 0.3, Element(abs, "block", length=0.1)]),
        OpticalSystem([Element(abs, "something")]),
        imaging_system(0.12, diameter=3.6e-3, koehler=True),
        OpticalSystem([Stop(1e-3), 0.1, Lens(np.inf, diameter=1e-3), 0.1]),
    ]:
        plot.save(plot.system(system), tmp_path / "system.png", dpi=40)
        assert np.ptp(imageio.imread(tmp_path / "system.png")[..., :3]) > 100


def test_bad_views():
    for change in [{"extent": 0}, {"extent": np.nan}, {"height": np.inf}]:
        with pytest.raises(ValueError, match=f"{next(iter(change))} must be .* in metres, got"):
            plot.system(PLENOPTIC, **change)
    with pytest.raises(TypeError, match=r"must be an OpticalSystem, got int: .*\[\.\.\.\]"):
        plot.system(3)


def test_an_image_on_lenslets_is_part_of_their_name():
    figure = plot.system(PLENOPTIC)  # 1/.03 - 1/.05 = 1/.075: the image lies on the lenslets
    assert "lenslets at the image\nf = 6 mm\npitch 1 mm" in words(figure)
    assert arrows(figure) == [pytest.approx((0.0, rays_through(PLENOPTIC).height))]
    beside = OpticalSystem([0.05, Lens(0.03, diameter=6e-3), 0.08, ARRAY, 6e-3])
    assert {"image", "lenslets\nf = 6 mm\npitch 1 mm"} <= set(words(plot.system(beside)))
    assert len(arrows(plot.system(beside))) == 2
    focused = OpticalSystem([Lens(0.03, diameter=6e-3), 0.03, ARRAY, 6e-3])
    assert "lenslets at the focus\nf = 6 mm\npitch 1 mm" in words(plot.system(focused))


def arrows(figure) -> list[tuple[float, float]]:
    """Tips of the arrows of object and images."""
    return [
        text.xy
        for text in figure.axes[0].texts
        if text.get_text() == "" and text.xyann[1] == 0 and text.xy[0] == text.xyann[0]
    ]


@pytest.mark.parametrize(("lattice", "fill"), [("square", "full"), ("hexagonal", "circular")])
def test_cameras_are_drawn_to_scale(lattice, fill, device):
    array = MicrolensArray(150e-6, 3e-3, count=(7, 9), lattice=lattice, fill=fill)
    camera = PlenopticCamera.type2(
        focal_length=0.12, m=0.25, mla=array, wavelength=532e-9, pixels_per_lenslet=12,
        aperture_diameter=10e-3, device=device,
    )  # fmt: skip
    pupil, lenslets, pixels = camera.plot().axes
    assert pupil.patches[0].radius == 5e-3
    images = [patch for patch in lenslets.patches if patch.get_linewidth() == 0]
    scale = camera.sensor_distance / camera.array_distance
    assert images[0].radius == pytest.approx(5e-3 * scale)
    pitch = 150e-6 * (1 + scale)
    middle = {tuple(np.round(np.array(image.center) / pitch, 6)) for image in images}
    assert {(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0)} <= middle
    airy = pixels.patches[-1].radius
    assert airy == pytest.approx(1.22 * 532e-9 * camera.sensor_distance / 150e-6)
    with pytest.raises(TypeError, match="cam must be a plenoptic camera"):
        plot.camera(3)
