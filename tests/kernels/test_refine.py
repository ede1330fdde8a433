"""refine.cl, normal_rows.cl and fit_rows.cl against float64 twins."""

from __future__ import annotations

import numpy as np
import pytest
from reference_matching import centre_shares, fit, membership, normal
from tolerance import relative_max

from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.matching.view_matching import group_views, shift_tables
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField

LIMITS = (60.0, 1.2, 0.5)  # tau, ratio, margin
BLOCK = 5  # pixels of an item: several a row, the last one not whole
OTHER_LANES = [pytest.param(4, marks=pytest.mark.thorough)]


def views(shape, seed=2):
    """Samples from 20 to 120 with neighbours that are alike."""
    random = np.random.default_rng(seed).uniform(20, 120, shape)
    for axis in (2, 3):
        random = (random + np.roll(random, 1, axis)) / 2
    return random.astype(np.float32)


def light_field(device, shape, **more):
    weights = np.ones(shape[:2])
    if weights.size > 5:
        weights[0, 1] = 0
    return LightField.from_array(views(shape), device=device, weights=weights, **more)


def skip_without_rows(device):
    if not device.rows:
        pytest.skip("kernels in vectors are for devices on which an item takes a row")


def compared(device, lf, start, limits=LIMITS, gain=1.0, lanes=0, wanted=None):
    """(A, B) of the kernel and of the twin; start: disparities, numbers of planes, planes."""
    disparity, nearest, planes = start
    ny, nx, channels = (*lf.shape[2:], 1)[:3]
    sorted_ = group_views(lf)
    moved = shift_tables(sorted_, planes, gain, device=device)
    A, B = (device.zeros((ny, nx), np.float32) for _ in "AB")
    kinds = {"SAMPLE": C_TYPE[lf.dtype], "CHANNELS": channels}
    if lanes:
        skip_without_rows(device)
        kernel = device.kernel("normal_rows.cl", "normal_rows", LANES=lanes, **kinds)
        launch, size = device.launch, (-(-nx // 16), ny)
    else:
        kernel = device.kernel("refine.cl", "normal", **kinds)
        launch, size = device.launch_rows, (ny, nx)
    wanted = np.ones((ny, nx), np.uint8) if wanted is None else wanted
    launch(
        kernel,
        size,
        A,
        B,
        lf.data,
        device.upload(wanted),
        device.upload(disparity.astype(np.float32)),
        device.upload(nearest.astype(np.int32)),
        moved.planes,
        device.upload(sorted_.view),
        device.upload(sorted_.step.astype(np.float32)),
        moved.at,
        moved.part,
        moved.slopes,
        moved.reach,
        *sorted_.upload(device),
        *(np.int32(n) for n in (len(sorted_.view), ny, nx)),
        *(np.float32(t) for t in limits),
    )
    lit = lf.weights.ravel() > 0
    S = gain * lf.to_numpy().reshape(-1, ny, nx, channels)[lit].astype(float)
    every = unit_steps(lf).reshape(-1, 2)
    steps = every[lit]
    share = membership(steps, every)
    want = normal(S, start, steps, share, centre_shares(steps), limits)
    return (device.download(A), device.download(B)), want


PLANES = np.array([-1.5, -0.625, 0.0, 0.4, 1.25])


def some_start(shape, seed=6, planes=PLANES):
    """Any plane at every pixel, and a disparity near it."""
    random = np.random.default_rng(seed)
    nearest = random.integers(0, len(planes), shape)
    return planes[nearest] + random.uniform(-0.2, 0.2, shape), nearest, planes


def close(want, got):
    """Both A and B: sums of K views and channels, less their means, which are no larger."""
    for one, other in zip(want, got, strict=True):
        assert other.dtype == np.float32
        assert relative_max(one, other) <= 1e-5


@pytest.mark.parametrize(
    "shape",
    [
        (3, 5, 7, 11, 3),
        (2, 4, 11, 8),  # even counts: four views make the centre
        (5, 1, 13, 3),
        (3, 2, 1, 9),
    ],
)
def test_normal(device, shape):
    lf = light_field(device, shape)
    got, want = compared(device, lf, some_start(shape[2:4]))
    close(want, got)


@pytest.mark.parametrize(
    ("shape", "limits"),
    [
        ((3, 5, 7, 43, 3), LIMITS),
        ((2, 4, 23, 37), (5.0, 1.2, 0.5)),
        ((3, 4, 9, 21), (60.0, 0.5, -1.0)),
        ((3, 2, 1, 9), LIMITS),
    ],
)
@pytest.mark.parametrize("lanes", [8, *OTHER_LANES])
def test_normal_in_vectors(device, shape, limits, lanes):
    lf = light_field(device, shape)
    for planes in (5, 13):  # moved plane by plane, and pixel by pixel
        start = some_start(shape[2:4], planes=np.linspace(-1.5, 1.25, planes))
        got, want = compared(device, lf, start, limits, lanes=lanes)
        close(want, got)


@pytest.mark.parametrize("lanes", [0, 8])
def test_normal_of_wanted_pixels(device, lanes):
    lf = light_field(device, (3, 3, 9, 37))
    wanted = (np.random.default_rng(3).random((9, 37)) < 0.4).astype(np.uint8)
    start = some_start((9, 37))
    every, _ = compared(device, lf, start, lanes=lanes)
    some, _ = compared(device, lf, start, lanes=lanes, wanted=wanted)
    for whole, part in zip(every, some, strict=True):
        np.testing.assert_array_equal(part, whole * wanted)


def test_normal_of_views_on_no_grid(device):
    positions = np.random.default_rng(5).integers(-12, 13, (3, 3, 2)) / 8
    lf = light_field(device, (3, 3, 9, 11), positions=positions)
    got, want = compared(device, lf, some_start((9, 11)))
    close(want, got)


def fitted(device, maps, picture, scales, prior, *, ridge, most, radius, lanes=0):
    shape = maps[0].shape
    out, known = (device.empty(shape, np.float32) for _ in "ok")
    alike, near, level = scales
    sizes = {"CHANNELS": picture.shape[2], "RADIUS": radius}
    if lanes:
        skip_without_rows(device)
        kernel, block = device.kernel("fit_rows.cl", "fit_rows", LANES=lanes, **sizes), lanes
    else:
        block = BLOCK if device.rows else 1
        kernel = device.kernel("refine.cl", "fit", BLOCK=block, **sizes)
    device.launch(
        kernel,
        (-(-shape[1] // block), shape[0]),
        out,
        known,
        *(device.upload(a) for a in (*maps, np.moveaxis(picture, 2, 0).copy(), alike, near, prior)),
        *(np.float32(t) for t in (level, ridge, most)),
        *(np.int32(n) for n in shape),
    )
    return device.download(out), device.download(known)


@pytest.mark.parametrize(
    ("ny", "nx", "channels", "radius"),
    [(9, 43, 1, 2), (5, 17, 2, 8), (1, 9, 3, 2), (4, 6, 1, 0)],
)
@pytest.mark.parametrize("lanes", [0, 8, *OTHER_LANES])
def test_fit(device, ny, nx, channels, radius, lanes):
    random = np.random.default_rng(ny)

    def between(low, high, *more):
        return random.uniform(low, high, (ny, nx, *more)).astype(np.float32)

    maps = (between(0, 900), between(-150, 150), between(-0.2, 0.2))
    picture = between(0, 40, channels)
    scales = (between(1e-4, 2e-3), between(0.02, 0.3), 5.0)
    prior = between(50, 400)
    options = {"ridge": 0.3, "most": 0.1, "radius": radius}
    got = fitted(device, maps, picture, scales, prior, lanes=lanes, **options)
    assert (np.abs(maps[1]) > options["most"] * (maps[0] + prior)).any()  # some steps are cut
    wide = [a.astype(float) for a in (*maps, picture, scales[0], scales[1], prior)]
    want = fit(tuple(wide[:3]), wide[3], (*wide[4:6], scales[2]), wide[6], **options)
    # cofactors cancel to about a tenth at a corner; 4 products of sums of (2 radius + 1)^2 terms
    assert relative_max(want[0], got[0]) <= 1e-5
    assert relative_max(want[1], got[1]) <= 1e-5
