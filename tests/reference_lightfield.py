"""Float64 twins of the light-field steps: decode, render, refocus, and the thesis' depth.

Light fields L[v, u, y, x] or L[v, u, y, x, c]; centre view (V-1)/2, (U-1)/2. Disparity d in pixels
per view step, nearer is larger. Nothing here imports the package under test.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from reference_optics import Real


def sampling_matrix(
    positions: Real, n: int, *, kernel: str = "linear", edge: str = "zero"
) -> scipy.sparse.csr_array:
    """Matrix (len(positions), n) that interpolates n samples at real positions.

    kernel "linear", or "cubic" (Keys 1981, eq. 15, a = -1/2). A tap outside the samples has
    weight 0 (edge "zero") or takes the edge sample ("clamp").
    """
    taps = {"linear": (0, 1), "cubic": (-1, 0, 1, 2)}[kernel]
    weigh = {"linear": linear_kernel, "cubic": keys_kernel}[kernel]
    if edge not in ("zero", "clamp"):
        raise ValueError(f"edge {edge!r} is unknown: 'zero' or 'clamp'")
    positions = np.asarray(positions, dtype=float)
    index = np.floor(positions).astype(int)[:, None] + np.array(taps)
    weight = weigh(positions[:, None] - index)
    if edge == "zero":
        weight = np.where((index >= 0) & (index < n), weight, 0)
    rows = np.broadcast_to(np.arange(len(positions))[:, None], index.shape)
    entries = weight.ravel(), (rows.ravel(), np.clip(index, 0, n - 1).ravel())
    return scipy.sparse.coo_array(entries, shape=(len(positions), n)).tocsr()


def linear_kernel(t: Real) -> Real:
    return np.maximum(1 - np.abs(t), 0)


def keys_kernel(t: Real) -> Real:
    """Keys' cubic convolution kernel, a = -1/2."""
    t = np.abs(t)
    near = (1.5 * t - 2.5) * t**2 + 1
    far = ((-0.5 * t + 2.5) * t - 4) * t + 2
    return np.where(t <= 1, near, np.where(t < 2, far, 0))


def spline_kernel(t: Real) -> Real:
    """The cubic B-spline, for |t| <= 1 and for 1 < |t| < 2."""
    t = np.abs(t)
    near, far = 2 / 3 - t**2 + t**3 / 2, (2 - t) ** 3 / 6
    return np.where(t <= 1, near, np.where(t < 2, far, 0))


def apply(matrix: scipy.sparse.csr_array, a: Real, which: int) -> Real:
    """Multiply one axis of an array by a matrix."""
    first = np.moveaxis(a, which, 0)
    done = matrix @ first.reshape(len(first), -1)
    return np.moveaxis(done.reshape(-1, *first.shape[1:]), 0, which)


# Decode --------------------------------------------------------------------------------------


def decode_naive(raw: Real, pixels: int) -> Real:
    """Cut a raw image (ny pixels, nx pixels) into cells: L[v, u, y, x], a permutation."""
    ny, nx = raw.shape[0] // pixels, raw.shape[1] // pixels
    return raw.reshape(ny, pixels, nx, pixels).transpose(1, 3, 0, 2)


def decode_calibrated(raw: Real, pixels: int, *, magnification: float) -> Real:
    """Sample a raw image on its sub-images: L[v, u, y, x] of shape (pixels, pixels, ny, nx).

    View j of lenslet k lies at x_k magnification + (j - (pixels-1)/2) dx, magnification =
    1 + f_mu/F, all from the middle of the sensor; separable Keys cubic, 0 outside.
    """
    out = np.asarray(raw, dtype=np.float64)
    for which, n in enumerate(raw.shape):
        count = n // pixels
        lenslet = (np.arange(count) - (count - 1) / 2) * pixels * magnification
        view = np.arange(pixels) - (pixels - 1) / 2
        positions = (n - 1) / 2 + view[:, None] + lenslet[None, :]
        out = apply(sampling_matrix(positions.ravel(), n, kernel="cubic"), out, which)
    ny, nx = raw.shape[0] // pixels, raw.shape[1] // pixels
    return out.reshape(pixels, ny, pixels, nx).transpose(0, 2, 1, 3)


# Render and refocus --------------------------------------------------------------------------


def aperture_weights(views: tuple[int, int], kept: int) -> Real:
    """w[v, u] of a square aperture of kept views across: k//2 of the N - kept drop below."""
    sides = []
    for n in views:
        below = (n - kept) // 2
        sides.append(((np.arange(n) >= below) & (np.arange(n) < below + kept)).astype(float))
    return sides[0][:, None] * sides[1][None, :]


def viewpoint_weights(views: tuple[int, int], v: float, u: float) -> Real:
    """w[v, u] of a real viewpoint: bilinear between the four nearest views."""
    wv = sampling_matrix(np.array([v]), views[0]).toarray()[0]
    wu = sampling_matrix(np.array([u]), views[1]).toarray()[0]
    return wv[:, None] * wu[None, :]


def render(lf: Real, weights: Real, *, total: bool = False) -> Real:
    """Weighted mean of the views, or their weighted sum (total)."""
    image = np.tensordot(weights, lf, axes=2)
    return image if total else image / np.sum(weights)


def refocus(
    lf: Real, disparity: float, *, weights: Real | None = None, edge: str = "normalised"
) -> Real:
    """Mean over views of L[v, u](y - (v-vc) d, x - (u-uc) d), bilinear.

    edge "normalised": a tap outside a view has weight 0 and every pixel is divided by the weights
    it used, a pixel without any is 0; "clamp": the edge sample goes on for ever.
    """
    views, (ny, nx) = lf.shape[:2], lf.shape[2:4]
    w = np.ones(views) if weights is None else np.asarray(weights, dtype=float)
    rule = {"normalised": "zero", "clamp": "clamp"}[edge]
    total = np.zeros(lf.shape[2:])
    used = np.zeros((ny, nx) + (1,) * (lf.ndim - 4))
    for v, u in np.argwhere(w != 0):
        sy, sx = (v - (views[0] - 1) / 2) * disparity, (u - (views[1] - 1) / 2) * disparity
        my = sampling_matrix(np.arange(ny) - sy, ny, edge=rule)
        mx = sampling_matrix(np.arange(nx) - sx, nx, edge=rule)
        total += w[v, u] * apply(mx, apply(my, lf[v, u].astype(float), 0), 1)
        used += w[v, u] * np.multiply.outer(my.sum(axis=1), mx.sum(axis=1)).reshape(used.shape)
    return np.divide(total, used, out=np.zeros_like(total), where=used != 0)


def magnify(image: Real, alpha: float) -> Real:
    """Image on the plane F': I(x') = alpha^2 I(alpha x') about the middle, linear, 0 outside."""
    out = alpha**2 * image
    for which in (0, 1):
        n = image.shape[which]
        x = (n - 1) / 2 + alpha * (np.arange(n) - (n - 1) / 2)
        out = apply(sampling_matrix(x, n), out, which)
    return out


# The thesis' depth from focus ----------------------------------------------------------------


def thesis_curve(
    raw: Real, pixels: int, *, near: tuple[int, int], window: int = 31
) -> tuple[Real, Real]:
    """Focus measure of the thesis as printed: (alphas, E), alpha = .700 (.005) 1.300.

    Naive cells of the window round lenslet near = (x, y); lenslet index x and pixel index u from
    the middle of the window and of the cell; I(x') = sum_u L(x'/alpha + u (1 - 1/alpha), u),
    linear, 0 outside; E = sum of |FFT I|^2 over radii above 0.1 cycles per lenslet.
    """
    top, left = (max(0, i - window // 2) * pixels for i in (near[1], near[0]))
    part = raw[top : top + window * pixels, left : left + window * pixels].astype(float)
    ny, nx = part.shape[0] // pixels, part.shape[1] // pixels
    high = np.hypot(np.fft.fftfreq(ny)[:, None], np.fft.fftfreq(nx)[None, :]) > 0.1
    alphas = np.linspace(0.7, 1.3, 121)
    energies = []
    for alpha in alphas:
        sheared = thesis_shear(ny, pixels, alpha) @ part @ thesis_shear(nx, pixels, alpha).T
        energies.append(np.sum(np.abs(np.fft.fft2(sheared)[high]) ** 2))
    return alphas, np.array(energies)


def thesis_shear(count: int, pixels: int, alpha: float) -> scipy.sparse.csr_array:
    """Matrix (count, count pixels) that shears and sums one axis of a row of naive cells."""
    x = np.arange(count, dtype=np.float64) - (count - 1) / 2
    lenslets = np.zeros((count, count, pixels))
    for j in range(pixels):
        u = j - (pixels - 1) / 2
        position = (count - 1) / 2 + x / alpha + u * (1 - 1 / alpha)
        lenslets[:, :, j] = sampling_matrix(position, count).toarray()
    return scipy.sparse.csr_array(lenslets.reshape(count, count * pixels))


def thesis_alpha(raw: Real, pixels: int, *, near: tuple[int, int], window: int = 31) -> float:
    """The alpha at the highest value of thesis_curve."""
    alphas, energies = thesis_curve(raw, pixels, near=near, window=window)
    return float(alphas[np.argmax(energies)])
