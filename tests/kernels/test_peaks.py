"""peaks.cl against a float64 twin."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.lightfield.depth.cue import PeakTracker

EPS = 2.0**-24


def peak_twin(curve, values, start, lowest):
    """(place, confidence) of one pixel."""
    n = len(curve)
    sign = -1 if lowest else 1
    e = sign * curve
    padded = np.concatenate([[e[1]], e, [e[-2]]])  # an end is compared with one neighbour
    tops = [i for i in range(n) if padded[i] <= e[i] > padded[i + 2]]
    if not tops:
        return start, 0.0
    best = max(tops, key=lambda i: e[i])
    level = [i for i in range(n) if padded[i] == e[i] == padded[i + 2]]
    others = [curve[i] for i in tops + level if i != best]
    if best in (0, n - 1):
        return values[best], 0.0
    margin = 1.0
    if others:
        margin = 1 - (curve[best] / min(others) if lowest else max(others) / curve[best])
    near = slice(best - 1, best + 2)
    a, b, _ = np.polyfit(values[near] - values[best], e[near], 2)
    k = -2 * a / curve[best]
    return values[best] - b / (2 * a), margin * k / (1 + k)


@pytest.mark.parametrize("lowest", [False, True])
@pytest.mark.parametrize(
    ("shape", "values", "at_once"),
    [
        ((13, 17), np.linspace(-2, 2, 9), 4),
        ((5, 16), np.array([-1.7, -1.6, -0.9, 0.0, 0.05, 0.8, 2.3]), 1),
        ((31, 3), np.array([-1.7, -1.6, -0.9, 0.0, 0.05, 0.8, 2.3]), 7),
        ((5, 16), np.array([0.1, 0.2, 0.5]), 2),
    ],
)
def test_peak(device, shape, values, at_once, lowest):
    size = shape[0] * shape[1]
    curves = (0.1 + np.random.default_rng(7).random((len(values), size))).astype(np.float32)
    curves[:, 2 * shape[1]] = 0  # a curve that is flat
    tracker = PeakTracker(shape, device=device, start=0.125, capacity=at_once, lowest=lowest)
    for first in range(0, len(values), at_once):
        some = curves[first : first + at_once]
        with device.on_host(tracker.curve) as planes:
            planes[tracker.stored * size : (tracker.stored + len(some)) * size] = some.ravel()
        tracker.add(values[first : first + at_once])
    place, confidence = (found.ravel() for found in tracker.finish())
    want = np.array([peak_twin(c, values, 0.125, lowest) for c in curves.T.astype(np.float64)])
    # the vertex lies within half a step, from quotients of differences of values up to 1.1
    step = np.diff(values).max()
    assert np.abs(place - want[:, 0]).max() <= EPS * (np.abs(values).max() + 12 * step)
    assert np.abs(confidence - want[:, 1]).max() <= 24 * EPS
    assert confidence[2 * shape[1]] == 0
    assert place[2 * shape[1]] == np.float32(0.125)
    assert confidence.min() >= 0
    assert 0.1 < confidence.max() <= 1


def test_a_cost_of_nothing(device):
    """Views that agree exactly are sure where they agree on one plane only."""
    cases = (
        ([3.0, 1.0, 0.0, 2.0, 3.0], 2 - 1 / 6, 1),
        ([3.0, 0.0, 0.0, 2.0, 3.0], 1.5, 1),  # right between two planes
        ([0.0, 0.0, 0.0, 2.0, 3.0], 1.5, 0),  # a plateau
        ([2.0, 0.0, 1.0, 0.0, 3.0], 1 + 1 / 6, 0),  # two places
        ([0.0, 0.0, 0.0, 0.0, 0.0], 9, 0),
    )
    tracker = PeakTracker((1, 5), device=device, start=9.0, capacity=5, lowest=True)
    with device.on_host(tracker.curve) as planes:
        planes[:25] = np.transpose([curve for curve, _, _ in cases]).ravel()
    tracker.add(np.arange(5.0))
    found, confidence = tracker.finish()
    np.testing.assert_allclose(found[0], [place for _, place, _ in cases], rtol=1e-6)
    np.testing.assert_array_equal(confidence[0], [sure for _, _, sure in cases])
