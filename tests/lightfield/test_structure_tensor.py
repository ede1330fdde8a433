"""The cue of the structure tensor against its definition in float64."""

from __future__ import annotations

import numpy as np
import pytest
from reference_cues import coherence, epi_tensor, grid_steps
from scipy.ndimage import gaussian_filter

from clplen.lightfield.depth.structure_tensor_cue import structure_disparity
from clplen.lightfield.model.light_field import LightField


def orientations(L, shears, weights):
    """(disparity, coherence) of every shear, shape (n, y, x)."""
    found = []
    for d0 in shears:
        J = []
        for axis in (1, 0):
            tensor = epi_tensor(L, d0, weights, grid_steps(L.shape[:2]), axis)
            J.append(gaussian_filter(tensor, (0, 2, 2), mode="reflect", truncate=4.0))
        both = coherence(J[0]) * J[0] + coherence(J[1]) * J[1]
        off = np.divide(both[1], both[0], out=np.zeros_like(both[0]), where=both[0] > 0)
        found.append((d0 + off, np.where(np.abs(off) <= 0.75 * 0.25, coherence(both), 0)))
    return (np.array(part) for part in zip(*found, strict=True))


def test_against_its_definition(device):
    shape = (3, 4, 17, 23, 3)
    random = np.random.default_rng(2)
    V, U, ny, nx = shape[:4]
    y, x = np.arange(ny)[:, None], np.arange(nx)[None, :]
    waves, phase = random.uniform(-0.2, 0.2, (2, 20)), random.uniform(0, 2 * np.pi, 20)
    L = np.empty((V, U, ny, nx))
    for v, u in np.ndindex(V, U):  # about a slanted plane from -0.5 to 0.5
        Y, X = y + (x / nx - 0.5) * (v - 2), x + (x / nx - 0.5) * (u - 1.5)
        turns = np.multiply.outer(Y, waves[0]) + np.multiply.outer(X, waves[1])
        L[v, u] = np.cos(2 * np.pi * turns + phase).sum(axis=-1)
    L = L[(..., *(None,) * (len(shape) - 4))] + random.normal(0, 0.3, shape)
    L = L.astype(np.float32)
    weights = random.uniform(0.5, 1.5, shape[:2]).astype(np.float32)
    lf = LightField.from_array(L, device=device, weights=weights)
    found, confidence = structure_disparity(lf, np.array([-0.5, 0.2, 0.5]))
    samples = L.reshape(*shape[:4], -1).astype(float)
    place, c = orientations(samples, np.linspace(-0.5, 0.5, 5), weights.astype(float))
    best = np.argmax(c, axis=0)[None]
    want = np.take_along_axis(place, best, 0)[0].clip(-0.5, 0.5)
    top = np.sort(c, axis=0)
    clear = top[-1] - top[-2] > 1e-3  # float32 tells these coherences apart
    assert clear.mean() > 0.7
    assert np.abs(found - want)[clear].max() < 1e-4
    assert (confidence[clear] <= top[-1][clear] + 1e-4).all()


def test_views_in_no_rows_are_refused(device):
    rng = np.random.default_rng(5)
    L = rng.random((5, 5, 24, 24), np.float32)
    lf = LightField.from_array(L, device=device, positions=rng.uniform(-2, 2, (5, 5, 2)))
    with pytest.raises(ValueError, match="rows and columns, which these positions"):
        structure_disparity(lf, np.array([-1.0, 0, 1]))
