"""Raw frames to light fields: the law that views obey, colours, bad pixels and refusals."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from reference_lattice import Drawn, white
from reference_lattice import lattice as drawn_lattice

from clplen import (
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    SurfaceScene,
    focal_stack,
    refocus,
)
from clplen.cameras import Plane
from clplen.errors import ShapeError
from clplen.lightfield.calibration.lattice_fit import estimate_lattice
from clplen.lightfield.calibration.raw_decoding import decode_raw
from clplen.lightfield.raw.lenslet_lattice import Lattice

RANDOM = np.random.default_rng(11)
KINDS = ("square", "hexagonal", "turned")


def of_drawn(true: Drawn, kind: str, shape: tuple[int, int]) -> Lattice:
    """The lattice that was drawn, as the package describes it."""
    first, second = true.first, true.second
    row, column = {
        "square": (second, first),
        "hexagonal": (second - first / 2, first),
        "turned": (second, first - second / 2),
    }[kind]
    name = "square" if kind == "square" else "hexagonal"
    return Lattice(name, tuple(true.origin), tuple(row), tuple(column), shape)


RECTANGULAR = Lattice("square", (31.3, 36.6), (9.41, 0.7), (-0.6, 8.87), (67, 83))
def waves(at: np.ndarray) -> np.ndarray:
    """A scene, by places (..., 2) on the sensor in pixels: a wave 25 lenslets long."""
    return 2 + np.cos(0.021 * at[..., 0] - 0.014 * at[..., 1] + 0.3)


def captured(true: Drawn, shape: tuple[int, int], slope: float, scene=waves) -> np.ndarray:
    """What lies under lenslets: the scene at centre + slope (place - centre)."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    _, _, dy, dx = true.nearest(y, x)
    return scene(np.stack([y + (slope - 1) * dy, x + (slope - 1) * dx], -1))


def pixels_of(lattice: Lattice, lf: LightField) -> tuple[np.ndarray, float]:
    """Places (y, x, 2) on the sensor of the centre view's pixels, and their distance."""
    grid = lf.raw.sub_images
    unit = min(lattice.pitch)
    steps = [np.array(s) / np.hypot(*s) * unit for s in (lattice.row, lattice.column)]
    if lattice.kind == "square":
        steps = [np.array(lattice.row), np.array(lattice.column)]
    i, k = np.indices(lf.shape[2:])[..., None]
    return np.array(grid.first) + i * steps[0] + k * steps[1], unit


@pytest.mark.parametrize(
    ("kind", "degrees", "d", "views", "step"),
    [
        ("square", -7.0, 0.8, (7, 6), 1),
        ("hexagonal", 0.0, -0.5, (7, 6), 1),
        ("turned", -7.0, 0.0, (7, 6), 1),
        ("square", 3.0, 0.4, (3, 2), None),
        ("turned", 3.0, 1 / 14 / np.sqrt(0.75), (9, 8), None),  # one scene without borders of cells
    ],
)
def test_views_obey_the_law_of_disparity(device, kind, degrees, d, views, step):
    """L[v, u](y, x) = T(y + d (v - vc), x + d (u - uc)), T as the middle of the lenslets has it."""
    true = drawn_lattice(kind, 14.0, degrees=degrees, origin=(83.2, 88.9))
    lattice = of_drawn(true, kind, (167, 181))
    unit = 14.0 if kind == "square" else 14.0 * np.sqrt(0.75)
    frame = captured(true, (167, 181), d * unit)
    lf = decode_raw(frame, lattice, device=device, views=views, step=step)
    at, distance = pixels_of(lattice, lf)
    assert distance == pytest.approx(unit)
    down, right = (np.array(s) / np.hypot(*s) for s in (lattice.row, lattice.column))
    v = (np.arange(views[0]) - (views[0] - 1) / 2)[:, None, None, None, None]
    u = (np.arange(views[1]) - (views[1] - 1) / 2)[:, None, None, None]
    dv, du = (step or 14.0 / n for n in views)  # pixels a view
    want = waves(at + d * unit * (v * dv * down + u * du * right))
    inner = (..., slice(2, -2), slice(2, -2))  # hexagonal rows end where their last lenslet does
    # Keys' error is below .008 h^3 f''': .35 a lenslet, 28 times less a pixel but for the jumps
    # at the borders of the cells, which views within 4.7 pixels do not reach
    assert np.abs(lf.to_numpy() - want)[inner].max() <= 1e-3
    if step == 1:  # a pixel of the sub-image is a view
        picture = refocus(lf, disparity=d).to_numpy()
        # linear interpolation: h^2 f''/8
        assert np.abs(picture - waves(at))[4:-4, 4:-4].max() <= 0.35**2 / 8 + 1e-3


def flat(kind: str = "square", shape=(120, 131), **more) -> tuple[Lattice, np.ndarray]:
    """A lattice of 11 pixels and its white image."""
    true = drawn_lattice(kind, 11.0, degrees=2.0, stretch=1.002, origin=(60.3, 65.8))
    return of_drawn(true, kind, shape), white(shape, true, **more)


@pytest.mark.parametrize("kind", KINDS)
def test_devignetting_restores_a_flat(device, kind):
    lattice, even = flat(kind)
    dark = RANDOM.normal(100, 2, even.shape)
    lf = decode_raw(70 * even + dark, lattice, device=device, white=300 * even + dark, dark=dark)
    level = decode_raw(even, lattice, device=device).to_numpy()
    lit = level > 0.06
    assert 0.5 < lit.mean() < 1
    bright = np.quantile(even, 0.995)
    # values near 100 in float32, less 100, over the least white of 6 %
    np.testing.assert_allclose(lf.to_numpy()[lit], 70 * bright, rtol=100 * 2**-22 / (70 * 0.06))
    means = level.mean((2, 3), dtype=np.float64)
    np.testing.assert_allclose(lf.weights, np.maximum(means / means.max(), 0), atol=2e-4)
    assert lf.weights.max() == 1
    dim = lf.to_numpy()[level < 0.04 * bright]
    np.testing.assert_allclose(dim, 70 * level[level < 0.04 * bright] / 0.05, atol=0.01)


# Colours --------------------------------------------------------------------------------------


def colours(at: np.ndarray) -> np.ndarray:
    """Three different waves, (..., 3)."""
    y, x = at[..., 0], at[..., 1]
    phases = (0.02 * y, 0.016 * x + 1, 0.012 * (x - y))
    return np.stack([(3 - c) * (2 + np.cos(phase)) for c, phase in enumerate(phases)], -1)


def mosaic(picture: np.ndarray, bayer: str) -> np.ndarray:
    """What a sensor behind Bayer filters has of a picture of three colours."""
    out = np.zeros(picture.shape[:2])
    for n, colour in enumerate(bayer):
        place = (slice(n // 2, None, 2), slice(n % 2, None, 2))
        out[place] = picture[(*place, "RGB".index(colour))]
    return out


@pytest.mark.parametrize(
    ("kind", "demosaic", "bayer"),
    [
        ("square", "within", "RGGB"),
        ("square", "after", "gbrg"),
        ("hexagonal", "before", "BGGR"),
        ("hexagonal", "within", "gbrg"),
        ("turned", "after", "GRBG"),
        ("turned", "within", "RGGB"),
    ],
)
def test_colours_of_a_mosaic(device, bayer, demosaic, kind):
    true = drawn_lattice(kind, 14.3, degrees=3.0, origin=(83.2, 88.9))
    lattice = of_drawn(true, kind, (167, 181))
    scene = captured(true, (167, 181), 3.0, colours)
    even = white((167, 181), true, name="gauss")[..., None] * np.array([0.5, 1, 0.7])
    words = {"device": device, "views": (9, 9), "step": 1}
    want = np.stack(
        [decode_raw(scene[..., c], lattice, **words).to_numpy() for c in range(3)], axis=-1
    )
    lf = decode_raw(
        mosaic(scene * even, bayer.upper()),
        lattice,
        white=mosaic(even, bayer.upper()),
        bayer=bayer,
        demosaic=demosaic,
        **words,
    )
    assert lf.shape == want.shape
    bright = np.array([0.5, 1, 0.7]) * np.quantile(even[..., 1], 0.995)
    error = (lf.to_numpy() / bright - want) / want.mean()
    # red changes by up to .05 a pixel and .2 a lenslet; "after" takes what it misses from there;
    # white levels, quantiles of one colour, are right to 1 %
    limit = {"within": 0.012, "after": 0.04, "before": 0.012}[demosaic]
    assert np.sqrt((error**2).mean()) < limit
    assert np.abs(error).max() < 6 * limit
    assert lf.weights.max() == 1
    assert 0 < lf.weights.min() < 0.5


def test_after_mixes_no_directions(device):
    """Light from the left half of the pupil is red, from the right half blue."""
    true = drawn_lattice("square", 14.3, origin=(83.2, 88.9))
    lattice = of_drawn(true, "square", (167, 181))
    y, x = np.mgrid[:167, :181].astype(np.float64)
    right = true.nearest(y, x)[3] > 0
    scene = np.stack([1.0 * ~right, np.full(right.shape, 0.5), 1.0 * right], -1)
    found = {
        how: decode_raw(
            mosaic(scene, "GRBG"), lattice, device=device, views=(9, 10), step=1, bayer="GRBG",
            demosaic=how,
        ).to_numpy()
        for how in ("after", "before")
    }  # fmt: skip
    truth = np.array([[1, 0.5, 0], [0, 0.5, 1]])
    wrong = {}
    for how, views in found.items():
        wrong[how] = np.abs(views[:, 3] - truth[0]).mean() + np.abs(views[:, 6] - truth[1]).mean()
        # three pixels off every border, as far as both reach
        assert np.abs(views[:, 1] - truth[0]).max() < 1e-5
        assert np.abs(views[:, 8] - truth[1]).max() < 1e-5
    assert wrong["after"] < 0.1 * wrong["before"]  # a pixel and a half off


# Bad pixels -----------------------------------------------------------------------------------


def test_hot_pixels_are_replaced(device):
    true = drawn_lattice("square", 14.0, origin=(83.2, 88.9))
    lattice = of_drawn(true, "square", (167, 181))
    scene = 1000 * captured(true, (167, 181), 1.0)
    clean = decode_raw(scene, lattice, device=device).to_numpy()
    dark = np.full(scene.shape, 100, np.uint16)
    hot = RANDOM.random(scene.shape) < 2e-3
    dark[hot] = 3000
    frame = np.where(hot, 60000, scene + 100).astype(np.uint16)
    lf = decode_raw(frame, lattice, device=device, dark=dark)
    # numbers were cut to integers; a mean of eight neighbours lies off where the scene is curved
    assert np.abs(lf.to_numpy() - clean).max() < 0.05 * clean.mean()
    unmended = decode_raw(frame, lattice, device=device).to_numpy()
    assert np.abs(unmended - clean).max() > 10 * clean.mean()


# What is refused ------------------------------------------------------------------------------


FLAT = np.ones((67, 83))
REFUSED = [
    (FLAT, {"views": (0, 3)}, ValueError, r"views must be \(V, U\)"),
    (FLAT, {"views": (2.5, 3)}, ValueError, r"views must be \(V, U\)"),
    (FLAT, {"step": 0}, ValueError, "step must be a positive number"),
    (FLAT, {"step": np.nan}, ValueError, "step must be a positive number"),
    (FLAT, {"pixel_pitch": -1e-6}, ValueError, "pixel_pitch must be positive"),
    (FLAT, {"demosaic": "never"}, ValueError, "'within', 'after' or 'before'"),
    (FLAT, {"bayer": "RGBG"}, ValueError, "bayer must be 'RGGB'"),
    (FLAT, {"devignette": True}, ValueError, "pass white="),
    (FLAT, {"white": np.ones((67, 82))}, ShapeError, "white must have the shape"),
    (FLAT, {"dark": np.ones((66, 83))}, ShapeError, "dark frame must have the picture's shape"),
    (FLAT, {"white": 0 * FLAT}, ValueError, "white image is black"),
    (FLAT, {"white": np.inf * FLAT}, ValueError, "white image has 5561 pixels that are"),
    (FLAT, {"dark": np.nan * FLAT}, ValueError, "dark frame has 5561 pixels that are"),
    (FLAT, {"views": (80, 80), "step": 1}, ShapeError, "No lenslet"),
    (np.ones((67, 83, 3)), {}, ShapeError, r"must have shape \(ny, nx\)"),
    (np.ones((67, 84)), {}, ShapeError, "pass the lattice of this camera"),
    (FLAT.astype(complex), {}, ValueError, "must be real"),
    (np.nan * FLAT, {}, ValueError, "5561 pixels that are NaN"),
]


def test_what_is_refused(device):
    for frame, words, error, text in REFUSED:
        with pytest.raises(error, match=text):
            decode_raw(frame, RECTANGULAR, device=device, **words)


# A real frame ---------------------------------------------------------------------------------

SCALE = 0.069 * 100 / 60  # of d, by depth in lenslets: 0.069 a um, 100 um a lenslet, 60 times


def test_a_vesicle_is_sharp_on_both_sides(data_folder, device):
    """Rings of the shell at both depths of a sphere, and what lies on the glass below it."""
    names = ("Lightfield", "Radiometry", "DarkFrame")
    frame, even, dark = (
        tifffile.imread(data_folder / "lfm_guv" / f"{name}_GUVExperim1.tif") for name in names
    )
    lf = decode_raw(frame, estimate_lattice(even, dark=dark), device=device, white=even, dark=dark)
    assert lf.shape == (15, 15, 28, 28)
    assert lf.weights[7, 7] > 0.95
    assert lf.weights[0, 0] < 0.15  # the corners of square lenslets behind a round pupil
    d = np.linspace(-1.5, 1.5, 61)
    stack = device.download(focal_stack(lf, disparities=d).data)
    y, x = np.indices((28, 28))
    radius = np.hypot(y - 14, x - 13)
    equator = [stack[30][np.abs(radius - r) < 0.6].mean() for r in np.arange(6, 11, 0.1)]
    R = 6 + 0.1 * int(np.argmax(equator))
    assert pytest.approx(7.9, abs=0.3) == R
    for r in (6, 7):
        light = stack[:, np.abs(radius - r) < 0.7].mean(1)
        expected = SCALE * np.sqrt(R**2 - r**2)
        far, near = d[:30][light[:30].argmax()], d[31:][light[31:].argmax()]
        assert -far == pytest.approx(expected, abs=0.25)
        assert near == pytest.approx(expected, abs=0.25)
    for y0, x0 in ((5, 5), (19, 3)):  # it rests on the glass, R nearer to the objective
        spot = stack[:, y0 - 1 : y0 + 3, x0 - 1 : x0 + 2]
        about = np.hypot(y - y0, x - x0)
        contrast = spot.max((1, 2)) - np.median(stack[:, (about > 2) & (about < 4)], axis=1)
        assert d[contrast.argmax()] == pytest.approx(SCALE * R, abs=0.15)


# A camera of this package ----------------------------------------------------------------------


@pytest.mark.thorough
def test_a_simulated_frame_by_its_white_image(device):
    """What is found on a white image decodes as the camera's own geometry does."""
    array = MicrolensArray(150e-6, 10e-3, count=27, fill="full")
    camera = PlenopticCamera.type1(
        focal_length=0.12, mla=array, wavelength=532e-9, pixels_per_lenslet=12, device=device
    )
    even = camera.expose(SurfaceScene(Plane(0.0)), model="rays").to_numpy()
    points = [(-5e-4, -3e-4, -0.02), (0, 0, 0), (4e-4, 6e-4, 0.03)]
    raw = camera.expose(PointSources(points, diameter=1e-5))
    geometric = LightField.from_raw(raw).to_numpy()
    lattice = estimate_lattice(even)
    assert lattice.trust == "high"
    assert lattice.pitch == pytest.approx([12.5] * 2, rel=2e-4)
    words = {"views": (12, 12), "step": 1, "devignette": False, "complete": False}
    lf = decode_raw(raw.to_numpy(), lattice, device=device, white=even, **words)
    inside = geometric[:, :, 1:-1, 1:-1]  # the centres of the others lie off the sensor
    assert lf.shape == inside.shape == (12, 12, 25, 25)
    assert np.corrcoef(lf.to_numpy().ravel(), inside.ravel())[0, 1] >= 0.999
