"""Checks of adjoints of light fields: stacks and raw images spread back, a warp's gradients."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.arrays.shear_adjoint import shear_adjoint
from clplen.lightfield.raw.decode_adjoint import resample_adjoint
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.refocusing.view_warp import ViewWarp
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs
from clplen.selftest.frames import TURNED, UPRIGHT, lenslet_centres

ROUNDING = 1e-5  # sums over planes, views and taps


def _spread(device: Device) -> Pairs:
    """Every view is the sum of the planes by the transposed matrices of both axes."""
    shape, planes = (3, 4, 9, 43, 3), np.array([-1.37, 1.0, 0.4])
    pictures, w = twins.reals(1, 3, *shape[2:]), twins.reals(7, 3, 4, low=0.2, high=1.7)
    w[0, 1] = 0
    steps = twins.view_steps((3, 4)) * (1.3, 1)
    down, right = np.outer(planes, steps[:, 0, 0]), np.outer(planes, steps[0, :, 1])
    expected = np.zeros(shape)
    for p in range(3):
        my = [twins.interpolation(np.arange(9) + s, 9) for s in down[p]]
        mx = [twins.interpolation(np.arange(43) + s, 43) for s in right[p]]
        shares = [np.outer(my[v].sum(axis=1), mx[u].sum(axis=1)) for v, u in np.ndindex(3, 4)]
        share = pictures[p] / np.tensordot(w.ravel(), shares, 1)[..., None]
        for v, u in np.ndindex(3, 4):
            expected[v, u] += w[v, u] * np.einsum("ij,ikc,kl->jlc", my[v], share, mx[u])
    got = shear_adjoint(device.upload(pictures), shape, w, down, right, device=device)
    yield expected, device.download(got)


def _taken_back(views: Any, grid: LensletGrid, shape: tuple[int, int]) -> Any:
    """Samples at the true centres of sub-images, spread by cubic convolution."""
    V, U = grid.views
    y, x = lenslet_centres(grid)
    y = np.broadcast_to(y + (np.arange(V) - (V - 1) / 2)[:, None, None, None], views.shape)
    x = np.broadcast_to(x + (np.arange(U) - (U - 1) / 2)[:, None, None], views.shape)
    my, mx = (
        twins.interpolation(at.ravel(), n, kernel=twins.keys)
        for at, n in zip((y, x), shape, strict=True)
    )
    return np.einsum("pi,p,pj->ij", my, views.astype(float).ravel(), mx, optimize=True)


def _decoded(device: Device) -> Pairs:
    """Rows of a hexagonal array that were moved by half a lenslet are moved back first."""
    shape = (61, 83)
    for grid in (UPRIGHT, TURNED):
        views = twins.reals(2, *grid.shape)
        samples = views.astype(float)
        if grid.odd_row_shift:
            columns = grid.count[1]
            places = np.arange(columns) - grid.odd_row_shift
            back = twins.interpolation(places, columns, kernel=twins.keys, clamp=True)
            samples[:, :, 1::2] = samples[:, :, 1::2] @ back
        got = resample_adjoint(device.upload(views), shape, grid, device=device)
        yield _taken_back(samples, grid, shape), device.download(got)


def _warped(device: Device) -> Pairs:
    """Views of a picture by its disparity, and the gradients, by a matrix for each view."""
    shape, (ny, nx) = (2, 3, 7, 11), (7, 11)
    picture, g = twins.reals(3, ny, nx), twins.reals(4, *shape)
    d = twins.reals(5, ny, nx, low=-2.3, high=1.9)
    model = ViewWarp(shape, device=device)
    y, x = np.mgrid[:ny, :nx]
    views, of_picture, of_disparity = np.zeros(shape), np.zeros(ny * nx), np.zeros((ny, nx))
    for n in np.ndindex(2, 3):
        at = [p + d.astype(float) * s for p, s in zip((y, x), model.steps[n], strict=True)]
        at = [np.clip(p, 0, k - 1).ravel() for p, k in zip(at, (ny, nx), strict=True)]
        my, mx = (twins.interpolation(p, k) for p, k in zip(at, (ny, nx), strict=True))
        views[n] = np.einsum("pi,ij,pj->p", my, picture.astype(float), mx).reshape(ny, nx)
        of_picture += np.einsum("pi,p,pj->ij", my, g[n].ravel().astype(float), mx).ravel()
        for k, size in enumerate((ny, nx)):
            slope = [my, mx]
            inside = (at[k] > 0) & (at[k] < size - 1)
            whole = np.clip(np.floor(at[k]).astype(int), 0, size - 2)
            slope[k] = inside[:, None] * (np.eye(size)[whole + 1] - np.eye(size)[whole])
            change = np.einsum("pi,ij,pj->p", slope[0], picture.astype(float), slope[1])
            of_disparity += g[n] * model.steps[n][k] * change.reshape(ny, nx)
    yield views, model.forward(picture, d).to_numpy()
    found = model.vjp(picture, d, g)
    yield of_picture.reshape(ny, nx), found[0]
    yield of_disparity, found[1]


CHECKS = (
    Check("shear_adjoint", "colours of three planes spread to the views", _spread, ROUNDING,
          ("shear_adjoint.cl", "shear_norm.cl")),
    Check("decode_adjoint", "views of two lattices back to the sensor", _decoded, ROUNDING,
          ("decode_adjoint.cl",)),
    Check("warp", "views of a picture, and their gradients", _warped, ROUNDING, ("warp.cl",)),
)  # fmt: skip
