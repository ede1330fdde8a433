"""Views of volumes: one scale of lengths, bars of a round length, tracks where they are."""

import numpy as np
import pytest

from clplen import ShapeError
from clplen.microscopy import Tracks
from clplen.plot import maximum_projection, orthogonal_views, rendered, scale_bar
from clplen.plot.base import new_figure
from clplen.plot.scale_bars import length_text, round_length

SHAPE = (7, 23, 41)
VOXEL = (3e-6, 0.7e-6, 0.5e-6)
VOLUME = np.random.default_rng(2).random(SHAPE)
SIZES = np.array(SHAPE) * VOXEL * 1e6  # um: 21, 16.1, 20.5


def test_a_bar_is_at_most_a_quarter():
    for width, length in [
        (90e-6, 20e-6),
        (80e-6, 20e-6),
        (79e-6, 10e-6),
        (7.9e-3, 1e-3),
        (4.0, 1.0),
        (3e-7, 5e-8),
    ]:
        assert round_length(width) == pytest.approx(length, rel=1e-12)


def test_lengths_in_words():
    words = [length_text(n) for n in (2e-5, 1e-6, 5e-10, 1e-3, 2.0, 999e-9)]
    assert words == ["20 µm", "1 µm", "500 pm", "1 mm", "2 m", "999 nm"]
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="width must be positive"):
            round_length(bad)


def test_the_bar_has_its_length_whichever_way_the_axes_run():
    for left, right in ((0, 80), (80, 0), (-3, 77)):
        axes = new_figure(4.0, 3.0).add_subplot()
        axes.set(xlim=(left, right), ylim=(50, 0))
        assert scale_bar(axes, 1e-6) == 2e-5
        (line,) = axes.lines
        assert abs(np.ptp(line.get_xdata())) == pytest.approx(20)
        assert axes.get_xlim() == (left, right)
        assert [text.get_text() for text in axes.texts] == ["20 µm"]


@pytest.mark.parametrize("at", [None, (2, 5, 30)])
def test_a_cube_looks_like_one(at):
    figure = orthogonal_views(VOLUME, voxel=VOXEL, at=at)
    panels = figure.axes[:3]
    inches = figure.get_size_inches()
    for panel, (down, across) in zip(panels, ((1, 2), (1, 0), (0, 2)), strict=True):
        box = panel.get_position()
        ratio = box.width * inches[0] / (box.height * inches[1])
        assert ratio == pytest.approx(SIZES[across] / SIZES[down])
        scale = box.width * inches[0] / SIZES[across]
        first = panels[0].get_position().width * inches[0] / SIZES[2]
        assert scale == pytest.approx(first)
        assert panel.images[0].get_extent() == pytest.approx([0, SIZES[across], SIZES[down], 0])
    shown = [np.asarray(panel.images[0].get_array()) for panel in panels]
    if at is None:
        expected = [VOLUME.max(0), VOLUME.max(2).T, VOLUME.max(1)]
    else:
        expected = [VOLUME[2], VOLUME[:, :, 30].T, VOLUME[:, 5]]
    for found, known in zip(shown, expected, strict=True):
        assert np.allclose(found, known)
    picture = rendered(figure, dpi=40)
    assert picture.dtype == np.uint8
    assert picture.shape[2] == 3


def test_tracks_lie_where_their_voxels_are():
    index = np.array([(1, 2, 3), (2, 4, 9), (5, 20, 40)])
    ids, frames = np.array([0, 0, 1]), np.array([0, 1, 1])
    origin = -9e-6
    metres = Tracks(ids, frames, index * VOXEL + (origin, 0, 0), np.ones(3), np.ones(3), "m")
    voxels = Tracks(ids, frames, index.astype(float), np.ones(3), np.ones(3), "voxel")
    for tracks in (metres, voxels):
        figure = orthogonal_views(VOLUME, voxel=VOXEL, tracks=tracks, frame=1, origin=origin)
        middles = (index + 0.5) * VOXEL * 1e6
        for panel, (down, across) in zip(figure.axes, ((1, 2), (1, 0), (0, 2)), strict=False):
            circles = panel.lines[0].get_xydata()
            assert circles == pytest.approx(middles[1:][:, [across, down]])
            (lines,) = panel.collections
            (segment,) = lines.get_segments()
            assert segment == pytest.approx(middles[:2][:, [across, down]])
    figure = orthogonal_views(VOLUME, voxel=VOXEL, tracks=voxels, frame=0)
    assert len(figure.axes[0].lines[0].get_xydata()) == 1
    assert not figure.axes[0].collections[0].get_segments()


def test_projections_of_a_series():
    series = np.stack([VOLUME * k for k in range(1, 8)])
    figure = maximum_projection(series, voxel=VOXEL, axis="y", max_frames=3)
    titles = [axes.get_title() for axes in figure.axes[:3]]
    assert titles == ["frame 0", "frame 3", "frame 6"]
    for panel, t in zip(figure.axes, (0, 3, 6), strict=False):
        (image,) = panel.images
        assert np.allclose(np.asarray(image.get_array()), series[t].max(1))
        assert image.get_extent() == pytest.approx([0, SIZES[2], SIZES[0], 0])
        assert image.get_clim() == (0, series.max().astype(np.float32))
        assert panel.get_aspect() == 1
    one = maximum_projection(VOLUME, voxel=VOXEL)
    assert one.axes[0].get_title() == "largest along z"


def test_what_is_not_drawn():
    for volume, words, error, sentence in [
        (VOLUME[0], {}, ShapeError, "planes, y, x"),
        (np.zeros((0, 3, 3)), {}, ShapeError, "planes, y, x"),
        (VOLUME, {"voxel": (1e-6, 1e-6)}, ValueError, "dz, dy, dx"),
        (VOLUME, {"voxel": (0, 1e-6, 1e-6)}, ValueError, "positive"),
        (VOLUME, {"at": (7, 0, 0)}, ValueError, "at must be"),
        (VOLUME, {"at": (0, 0)}, ValueError, "at must be"),
        (VOLUME, {"scale": "cube"}, ValueError, "scale must be"),
        (np.full(SHAPE, np.nan), {}, ValueError, "finite samples"),
    ]:
        with pytest.raises(error, match=sentence):
            orthogonal_views(volume, **({"voxel": VOXEL} | words))
    with pytest.raises(ValueError, match='"z", "y" or "x"'):
        maximum_projection(VOLUME, voxel=VOXEL, axis="t")
    with pytest.raises(ShapeError, match="t, planes, y, x"):
        maximum_projection(VOLUME[0], voxel=VOXEL)
    with pytest.raises(ValueError, match="at least 1"):
        maximum_projection(VOLUME, voxel=VOXEL, max_frames=0)
