"""The judge of disparity maps: every figure against what it must be by its definition."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from clplen.analysis.quality import Scores, score
from clplen.cameras.scenes.ground_truth import truth_of
from clplen.errors import ShapeError

SHAPE = (41, 53)
RANDOM = np.random.default_rng(3)
TRUTH = RANDOM.uniform(-1, 1, SHAPE)


def test_bad_pixels_are_counted_by_three_thresholds() -> None:
    error = np.zeros(SHAPE)
    error[20, 15:19] = (0.0101, -0.0302, 0.0699, -0.0701)  # of 253 pixels inside the border
    found = score(TRUTH + error, TRUTH)
    assert found.badpix_07 == pytest.approx(100 / 253)
    assert found.badpix_03 == pytest.approx(300 / 253)
    assert found.badpix_01 == pytest.approx(400 / 253)
    assert found.mse == pytest.approx(100 * (error**2).sum() / 253)


def test_the_border_is_ignored_on_all_four_sides() -> None:
    for place in ((0, 20), (14, 20), (26, 20), (20, 0), (20, 14), (20, 38), (40, 52)):
        wrong = TRUTH.copy()
        wrong[place] += 1
        assert score(wrong, TRUTH).badpix_07 == 0, place
        assert score(wrong, TRUTH, border=0).badpix_07 > 0, place
    for place in ((15, 15), (25, 37)):
        wrong = TRUTH.copy()
        wrong[place] += 1
        assert score(wrong, TRUTH).badpix_07 > 0, place


def test_q25_is_the_error_at_a_quarter_of_all() -> None:
    error = np.arange(30.0).reshape(5, 6)
    found = score(RANDOM.permuted(error.ravel()).reshape(5, 6), np.zeros((5, 6)), border=0)
    assert found.q25 == 100 * 7  # int(0.25 * 30)
    assert found.median == 14.5


def test_missing_pixels_are_bad_and_unknown_truth_is_left_out() -> None:
    found, known = TRUTH.copy(), TRUTH.copy()
    found[20, 15:25] = np.nan
    found[21, 15] = np.inf
    known[22, 15:18] = np.nan
    scores = score(found, known)
    assert scores.pixels == 250
    assert scores.missing == scores.badpix_07 == pytest.approx(100 * 11 / 250)
    assert scores.mse == 0
    nothing = score(np.full(SHAPE, np.nan), TRUTH)
    assert (nothing.badpix_07, nothing.q25, nothing.median) == (100, math.inf, math.inf)
    assert math.isnan(nothing.mse)


def test_bumpiness_of_a_bowl_and_its_clip() -> None:
    y, x = np.indices(SHAPE) - 20.0
    planes = np.ones(SHAPE)
    bowl = 1e-3 * (y**2 + 2 * x**2) / 2  # second derivatives 1e-3 and 2e-3, four times as filtered
    found = score(TRUTH + bowl, TRUTH, masks={"planes": planes})
    assert found.bumpiness_planes == pytest.approx(100 * 4e-3 * math.sqrt(5), rel=1e-9)
    assert math.isnan(found.bumpiness_smooth)
    tilted = score(TRUTH + 0.01 * y - 0.02 * x, TRUTH, masks={"smooth": planes})
    assert tilted.bumpiness_smooth == pytest.approx(0, abs=1e-9)
    rough = score(TRUTH + RANDOM.standard_normal(SHAPE), TRUTH, masks={"planes": planes})
    assert rough.bumpiness_planes == pytest.approx(5, rel=1e-3)
    holes = score(np.full(SHAPE, np.nan), TRUTH, masks={"planes": planes})
    assert holes.bumpiness_planes == pytest.approx(5)


def depth(d: np.ndarray) -> np.ndarray:
    return 1 / (0.1 * np.asarray(d) + 0.125)


CAMERA = SimpleNamespace(focal_length_mm=100.0, sensor_size_mm=35.0, depth=depth)


def test_normals_of_planes_in_space() -> None:
    known = np.zeros(SHAPE)
    masks = {"planes": np.ones(SHAPE)}
    assert score(known, known, masks=masks, parameters=CAMERA).mae_planes == 0
    # Z = 8 + s X on the projection of the benchmark, so that the normal turns by atan(s)
    x = np.arange(SHAPE[1]) / (SHAPE[1] - 1) / 2 * 0.35
    for s in (0.5, -1.5):
        Z = np.broadcast_to(8 / (1 - s * x), SHAPE)
        found = score((1 / Z - 0.125) / 0.1, known, masks=masks, parameters=CAMERA)
        assert found.mae_planes == pytest.approx(math.degrees(math.atan(abs(s))), abs=0.02)
        assert math.isnan(found.mae_smooth)
    y = np.arange(SHAPE[0])[:, None] / (SHAPE[0] - 1) / 2 * 0.35
    Z = np.broadcast_to(8 / (1 - 0.7 * y), SHAPE)
    found = score((1 / Z - 0.125) / 0.1, known, masks=masks, parameters=CAMERA)
    assert found.mae_planes == pytest.approx(math.degrees(math.atan(0.7)), abs=0.02)
    assert math.isnan(score(known, known, masks=masks).mae_planes)


def test_fattening_and_thinning_have_their_sides() -> None:
    known = np.zeros((40, 50))
    known[:, 20:30] = 1.0
    surface = (known > 0).astype(np.int32)
    truth = truth_of(known, surface, [False, False])
    fat = np.zeros((40, 50))
    fat[:, 18:32] = 1.0  # two of four far pixels on both sides came out near
    found = score(fat, truth, border=5)
    assert (found.fattening, found.thinning, found.edges) == (50, 0, 25)
    thin = np.zeros((40, 50))
    thin[:, 21:29] = 1.0
    found = score(thin, truth, border=5)
    assert (found.fattening, found.thinning) == (0, 25)
    slightly = score(known + 0.14, truth, border=5)
    assert (slightly.fattening, slightly.thinning) == (0, 0)


def test_a_cropped_map_lies_at_its_offset() -> None:
    cropped = TRUTH[10:35, 7:50]
    found = score(cropped, TRUTH, offset=(10, 7))
    assert (found.pixels, found.badpix_01, found.covered) == (253, 0, 100)
    assert score(cropped, TRUTH, offset=(9, 7)).badpix_07 > 50
    part = score(TRUTH[20:, :], TRUTH, offset=(20, 0))
    assert part.covered == pytest.approx(100 * 6 / 11)
    mask = np.zeros(SHAPE)
    mask[30] = 1
    assert score(cropped, TRUTH, offset=(10, 7), border=3, where=mask).pixels == 43


def test_the_table_leaves_out_what_is_not_known() -> None:
    text = str(score(TRUTH + 0.02, TRUTH))
    assert "BadPix 0.01" in text
    assert "MSE x 100" in text
    assert "bumpiness" not in text
    assert text.splitlines()[0].split() == ["pixels", "253"]
    assert len({line.index("%") for line in text.splitlines() if "%" in line}) == 1
    assert isinstance(score(TRUTH, TRUTH), Scores)


def test_bad_input_gets_one_sentence() -> None:
    for words, error, says in [
        ({"result": TRUTH[1:]}, ShapeError, "offset="),
        ({"result": TRUTH[None]}, ShapeError, r"shape \(y, x\)"),
        ({"offset": (1, 0)}, ShapeError, "does not lie within"),
        ({"offset": (-1, 0), "result": TRUTH[1:]}, ShapeError, "does not lie within"),
        ({"border": 21}, ValueError, "No pixel is left"),
        ({"border": -1}, ValueError, "border"),
        ({"truth": TRUTH * np.nan}, ValueError, "0 finite values"),
        ({"masks": {"plains": TRUTH}}, ValueError, "plains"),
        ({"masks": {"planes": TRUTH[1:]}}, ShapeError, "mask planes"),
        ({"where": TRUTH[1:]}, ShapeError, "mask where"),
        (
            {
                "masks": {"planes": TRUTH},
                "parameters": SimpleNamespace(
                    focal_length_mm=None, sensor_size_mm=1.0, depth=depth
                ),
            },
            ValueError,
            "focal length",
        ),
    ]:
        given = {"result": TRUTH, "truth": TRUTH} | words
        with pytest.raises(error, match=says):
            score(given.pop("result"), given.pop("truth"), **given)
