"""Linear maps of light fields: equal to the functions they are maps of, and exactly transposed."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import clplen
from clplen import LightField, RawImage, decode_raw, focal_stack
from clplen.compute.arrays import Image
from clplen.errors import ShapeError
from clplen.lightfield import (
    DecodeOperator,
    FocalStack,
    Lattice,
    LensletGrid,
    RenderOperator,
    StackOperator,
    ViewWarp,
)

EXACT = 1e-5  # |<A x, y> - <x, A' y>| / |<A x, y>|
PLANES = (-1.37, 0.0, 0.5, 2.2)


def numbers(shape, seed=1):
    """Of both signs, with a mean."""
    return (np.random.default_rng(seed).normal(size=shape) + 0.5).astype(np.float32)


def light_field(shape, device, **more):
    """With weights of its own, one of them 0."""
    weights = np.random.default_rng(2).uniform(0.3, 1.5, shape[:2])
    weights.flat[1] = 0
    return LightField.from_array(numbers(shape), device=device, weights=weights, **more)


def mismatch(linear, batch=(), seed=3):
    """|<A x, y> - <x, A' y>| / |<A x, y>| with y = A x and noise, in float64."""
    x = numbers((*batch, *linear.in_shape), seed)
    seen = linear.forward(x)
    y = seen + seen.std() * numbers(seen.shape, seed + 1)
    back = linear.adjoint(y)
    assert (seen.dtype, back.dtype) == (np.float32, np.float32)
    assert back.shape == x.shape
    product = np.vdot(seen.astype(float), y)
    return abs(product - np.vdot(x.astype(float), back)) / abs(product)


def matrix(linear):
    """(A, A') entry by entry."""
    A = linear.as_linear_operator()
    return A @ np.eye(A.shape[1], dtype=np.float32), A.H @ np.eye(A.shape[0], dtype=np.float32)


def small_raw(device):
    grid = LensletGrid((2, 3), (3, 2), (3.3, 2.1), (5.2, 0.3), (-0.2, 4.1), 0.5)
    return RawImage(device.upload(numbers((11, 13))), device, 5e-6, grid, grid)


def grey_raw(device, **more):
    grid = LensletGrid((4, 5), (3, 4), (8.3, 9.1), (7.2, 0.3), (-0.2, 8.1), 0.5)
    cells = LensletGrid((4, 5), (4, 4), (3.0, 4.0), (8.0, 0.0), (0.0, 8.0))
    return RawImage(device.upload(numbers((37, 47))), device, 5e-6, grid, cells, **more)


# Stacks


def test_forward_is_focal_stack_bit_for_bit(device):
    lf = light_field((3, 4, 11, 13, 3), device, spacing=(-1e-4, -1e-4, 2e-6, 2e-6))
    for planes in ({"disparities": PLANES}, {"alphas": [0.98, 1.0, 1.01]}):
        linear = StackOperator(lf, aperture=3, **planes)
        want, got = focal_stack(lf, aperture=3, **planes), linear.forward(lf)
        assert isinstance(got, FocalStack)
        np.testing.assert_array_equal(got.to_numpy(), want.to_numpy())
        np.testing.assert_array_equal(got.disparities, want.disparities)
        np.testing.assert_array_equal(got.alphas, want.alphas)
        np.testing.assert_array_equal(got.weights, want.weights)
        assert got.spacing == want.spacing
    one = clplen.refocus(lf, disparity=0.5).to_numpy()
    got = StackOperator(lf, disparities=[0.5]).forward(lf.to_numpy())
    np.testing.assert_array_equal(got[0], one)


def test_rescaled_stacks_are_those_of_refocus(device):
    lf = light_field((3, 4, 11, 13, 3), device, spacing=(-1e-4, -1e-4, 2e-6, 2e-6))
    linear = StackOperator(lf, alphas=[0.98, 1.01], rescale=True)
    got = linear.forward(lf.to_numpy())
    for picture, alpha in zip(got, linear.alphas, strict=True):
        want = clplen.refocus(lf, alpha=alpha, rescale=True).to_numpy()
        np.testing.assert_array_equal(picture, want)
    assert mismatch(linear) <= EXACT
    assert "disparities -0.5 to 1, rescaled" in repr(linear)
    with pytest.raises(ValueError, match="rescale=True needs a positive alpha"):
        StackOperator((2, 2, 5, 7), disparities=[0.1], rescale=True, device=device)


def test_dense_matrices(device):
    lf = light_field((2, 3, 3, 4), device)
    maps = (
        StackOperator(lf, disparities=[-1.2, 0.6]),
        RenderOperator(lf, viewpoint=(0.3, 1.6)),
        DecodeOperator(small_raw(device)),
    )
    for linear in maps:
        forward, backward = matrix(linear)
        assert forward.any()
        np.testing.assert_allclose(backward, forward.T, rtol=1e-5, atol=1e-6)


# Rendering


def test_forward_is_render_and_view(device):
    lf = light_field((3, 4, 7, 9, 3), device)
    for how in ({}, {"aperture": 2}, {"total": True}, {"viewpoint": (1.2, 2.5), "aperture": 0.6}):
        got = RenderOperator(lf, **how).forward(lf)
        assert isinstance(got, Image)
        np.testing.assert_array_equal(got.to_numpy(), lf.render(**how).to_numpy())
    for at in ((0, 1), (1.3, 2.6)):  # the first one a view of weight 0
        got = RenderOperator(lf, viewpoint=at).forward(lf.to_numpy())
        np.testing.assert_array_equal(got, lf.view(*at).to_numpy())


# Decoding


def test_forward_is_from_raw(device):
    raw = grey_raw(device, spacing=(-1e-4, -1e-4, 2e-6, 2e-6))
    for decode in ("calibrated", "naive"):
        linear, want = DecodeOperator(raw, decode=decode), LightField.from_raw(raw, decode=decode)
        got = linear.forward(raw)
        np.testing.assert_array_equal(got.to_numpy(), want.to_numpy())
        assert (got.spacing, got.decode) == (want.spacing, want.decode)
        back = linear.adjoint(got)
        assert isinstance(back, RawImage)
        assert back.sub_images == raw.sub_images


def test_forward_is_decode_raw_with_a_white_image(device):
    frame, white = np.abs(numbers((40, 52))), np.abs(numbers((40, 52), 9)) + 0.3
    dark = np.full((40, 52), 0.01, np.float32)
    lattice = Lattice("square", (10.3, 11.1), (6.2, 0.1), (-0.1, 6.1))
    lf = decode_raw(frame, lattice, white=white, dark=dark, device=device)
    linear = DecodeOperator(lf.raw, white=white, dark=dark)
    np.testing.assert_array_equal(linear.forward(lf.raw).to_numpy(), lf.to_numpy())
    assert mismatch(linear) <= EXACT
    assert "divided by a white image" in repr(linear)


def test_raw_images_with_colours_are_refused(device):
    raw = grey_raw(device, mosaic=(("R", "G"), ("G", "B")))
    with pytest.raises(ValueError, match="has colour filters"):
        DecodeOperator(raw)
    colour = RawImage(device.upload(numbers((37, 47, 3))), device, 1.0, raw.sub_images, raw.cells)
    with pytest.raises(ShapeError, match="got a colour picture"):
        DecodeOperator(colour)
    with pytest.raises(ValueError, match="decode must be 'calibrated' or 'naive', got 'best'"):
        DecodeOperator(grey_raw(device), decode="best")
    with pytest.raises(ShapeError, match=r"got \(3, 3\)"):
        DecodeOperator(grey_raw(device), white=np.ones((3, 3)))


# What all of them share


def maps(device):
    return (
        StackOperator((2, 3, 5, 7), disparities=[-0.4, 1.1], device=device),
        RenderOperator((2, 3, 5, 7, 3), aperture=2, device=device),
        DecodeOperator(grey_raw(device)),
    )


def test_leading_axes_are_mapped_one_by_one(device):
    for linear in maps(device):
        assert mismatch(linear, (2, 1)) <= EXACT
        x = numbers((3, *linear.in_shape))
        data = device.upload(x)
        every = device.download(linear.forward_data(data))
        alone = device.download(linear.forward_data(data[1]))  # has an offset
        np.testing.assert_array_equal(every, [linear.forward(one) for one in x])
        np.testing.assert_array_equal(alone, every[1])
        np.testing.assert_array_equal(device.download(data), x)
        y = device.upload(every)
        back = device.download(linear.adjoint_data(y))
        np.testing.assert_array_equal(back, [linear.adjoint(one) for one in every])
        np.testing.assert_array_equal(device.download(y), every)
        assert linear.forward(np.zeros((0, *linear.in_shape))).shape == (0, *linear.out_shape)


def test_representations_and_pickles(device):
    stack, picture, decoding = maps(device)
    assert repr(stack) == (
        f"<StackOperator (2, 3, 5, 7) to (2, 5, 7), disparities -0.4 to 1.1, {device.name}>"
    )
    assert "RenderOperator (2, 3, 5, 7, 3) to (5, 7, 3), 4 views of weight 1" in repr(picture)
    assert "DecodeOperator (37, 47) to (3, 4, 4, 5), calibrated" in repr(decoding)
    for linear in (stack, picture, decoding):
        again = pickle.loads(pickle.dumps(linear))
        x = numbers(linear.in_shape)
        np.testing.assert_array_equal(again.forward(x), linear.forward(x))


def test_what_does_not_fit_is_refused(device):
    stack, picture, decoding = maps(device)
    for linear in (stack, picture, decoding):
        with pytest.raises(ShapeError, match=r"must have shape"):
            linear.forward(np.ones((3, 3)))
        with pytest.raises(ShapeError, match=r"adjoint of this map must have shape"):
            linear.adjoint(np.ones((3, 3)))
        with pytest.raises(ShapeError, match="must get a C-contiguous float32 array of shape"):
            linear.forward_data(device.upload(np.ones(linear.in_shape)))
        with pytest.raises(TypeError, match="must hold real numbers"):
            linear.forward(np.ones(linear.in_shape, complex))
    with pytest.raises(TypeError, match="must get a LightField or an array of shape"):
        stack.forward(Image(device.upload(numbers((5, 7))), device))
    with pytest.raises(ShapeError, match=r"must get shape \(2, 3, 5, 7\), got \(2, 3, 5, 6\)"):
        stack.forward(LightField.from_array(numbers((2, 3, 5, 6)), device=device))
    bytes_only = LightField.from_array(np.ones((2, 3, 5, 7), np.uint8), device=device)
    with pytest.raises(TypeError, match="must get float32 samples, got a LightField of uint8"):
        stack.forward(bytes_only)
    assert StackOperator(bytes_only, disparities=[0.1]).in_shape == (2, 3, 5, 7)
    assert StackOperator(numbers((2, 3, 5, 7)), disparities=[0.1]).in_shape == (2, 3, 5, 7)
    with pytest.raises(TypeError, match="LightField"):
        StackOperator(7, disparities=[0.1])
    with pytest.raises(ShapeError, match="not empty"):
        RenderOperator((2, 3, 5))
    with pytest.raises(ValueError, match="exactly one of alphas and disparities"):
        StackOperator((2, 3, 5, 7), device=device)


# A picture and its disparity


def test_what_a_warp_cannot_take_is_refused(device):
    model = ViewWarp((2, 3, 5, 7), device=device)
    picture, d = np.ones((5, 7)), np.zeros((5, 7))
    with pytest.raises(ShapeError, match=r"The disparity of this model must have shape \(5, 7\)"):
        model.forward(picture, 0.3)
    with pytest.raises(ValueError, match="The disparity must be finite, got 1 values"):
        model.forward(picture, np.where(np.arange(35).reshape(5, 7) == 3, np.nan, d))
    with pytest.raises(ShapeError, match=r"gradient of the views of this model must have shape"):
        model.vjp(picture, d, picture)
    with pytest.raises(ShapeError, match=r"ViewWarp must get a float32 array of shape \(5, 7\)"):
        model.forward_data(device.upload(picture), device.upload(d))
