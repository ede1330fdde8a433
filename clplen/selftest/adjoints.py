"""Checks of adjoints of light fields: stacks and raw images spread back, a warp's gradients."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.arrays.shear_adjoint import shear_adjoint
from clplen.lightfield.raw.decode_adjoint import resample_adjoint
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.refocusing.raw_warp import RawWarp
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


def _warped_raw(device: Device) -> Pairs:
    """A raw image of turned, shifted lenslets, and the gradients, by a matrix of its pixels."""
    shape, grid = (61, 83), replace(TURNED, first=(13.217, 9.703))  # no pixel halfway
    rows, columns = grid.count
    picture, d = twins.reals(3, rows, columns), twins.reals(5, rows, columns, low=-0.9, high=0.7)
    white, g = twins.reals(7, *shape, low=0.2, high=1.7), twins.reals(4, *shape)
    raw = RawImage(device.zeros(shape, np.float32), device, math.nan, grid, grid)
    model = RawWarp(raw, white=white)
    beyond = replace(
        grid,
        count=(rows + 4, columns + 4),
        first=tuple(np.array(grid.first) - 2 * np.add(grid.row_step, grid.column_step)),
    )
    centres = lenslet_centres(beyond).reshape(2, -1, 1)
    pixels = np.indices(shape).reshape(2, 1, -1)
    own = ((pixels - centres) ** 2).sum(axis=0).argmin(axis=0)
    i, k = np.array(np.unravel_index(own, beyond.count)) - 2
    on = (i >= 0) & (i < rows) & (k >= 0) & (k < columns)
    v, u = (pixels - centres[:, own].reshape(2, 1, -1))[:, 0, on]
    i, k = i[on], k[on] + grid.odd_row_shift * (i[on] % 2)
    of_lenslet = (np.eye(rows)[i], twins.interpolation(k, columns, clamp=True))
    disparity = np.einsum("pi,ij,pj->p", of_lenslet[0], d.astype(float), of_lenslet[1])
    at = [i + v * disparity, k + u * disparity]
    my, mx = (twins.interpolation(p, n, clamp=True) for p, n in zip(at, grid.count, strict=True))
    factor, slope = white.ravel()[on].astype(float), 0.0
    seen = np.zeros(shape)
    seen.ravel()[on] = factor * np.einsum("pi,ij,pj->p", my, picture.astype(float), mx)
    yield seen, model.forward(picture, d).to_numpy()
    factor = factor * g.ravel()[on]
    for n, (size, turn) in enumerate(zip(grid.count, (v, u), strict=True)):
        ways, inside = [my, mx], (at[n] > 0) & (at[n] < size - 1)
        whole = np.clip(np.floor(at[n]).astype(int), 0, size - 2)
        ways[n] = (inside * turn)[:, None] * (np.eye(size)[whole + 1] - np.eye(size)[whole])
        slope = slope + np.einsum("pi,ij,pj->p", ways[0], picture.astype(float), ways[1])
    of_picture, of_disparity = model.vjp(picture, d, g)
    yield np.einsum("pi,p,pj->ij", my, factor, mx), of_picture
    yield np.einsum("pi,p,pj->ij", of_lenslet[0], factor * slope, of_lenslet[1]), of_disparity


CHECKS = (
    Check("shear_adjoint", "colours of three planes spread to the views", _spread, ROUNDING,
          ("shear_adjoint.cl", "shear_norm.cl")),
    Check("decode_adjoint", "views of two lattices back to the sensor", _decoded, ROUNDING,
          ("decode_adjoint.cl",)),
    Check("warp", "views of a picture, and their gradients", _warped, ROUNDING, ("warp.cl",)),
    Check("raw_warp", "pixels of lenslets, and their gradients", _warped_raw, ROUNDING,
          ("warp.cl",)),
)  # fmt: skip
