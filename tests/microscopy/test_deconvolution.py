"""Richardson and Lucy's iteration on simulated frames with photon noise."""

import numpy as np
import pytest

from clplen import MicrolensArray, PlenopticCamera, ShapeError
from clplen.microscopy.deconvolution import deconvolve
from clplen.microscopy.projector import Projector
from clplen.microscopy.psf import point_images

Z = np.arange(-40, 41, 10) * 1e-6


@pytest.fixture(scope="module")
def projector(device):
    """Nine planes, 9 x 9 lenslets, voxels of 1.25 um."""
    camera = PlenopticCamera.microscope(
        magnification=20, na=0.5, wavelength=525e-9, pixels_per_lenslet=25,
        mla=MicrolensArray(125e-6, 2.5e-3, count=9, fill="full"), device=device,
    )  # fmt: skip
    return Projector(point_images(camera, Z, cut=5e-3), (9, 9), device=device)


def counted(projector, voxels, photons=2e6):
    volume = np.zeros(projector.volume_shape, np.float32)
    for voxel in voxels:
        volume[voxel] = 1
    frame = projector.forward(volume)
    return np.random.default_rng(0).poisson(frame * (photons / frame.sum(dtype=float)))


def test_residuals(projector):
    frame = counted(projector, [(6, 22, 18), (6, 22, 26), (2, 15, 22)])
    found = deconvolve(frame, projector, iterations=31)
    assert (np.diff(found.residuals) < 0).all()
    # reference of an independent simulation
    assert found.residuals[[10, 20, 30]] == pytest.approx([0.067, 0.025, 0.0135], rel=0.2)
    assert found.volume.sum(dtype=float) == pytest.approx(2e6, rel=0.05)
    assert found.degenerate == (0.0,)
    assert "degenerate near the native plane: z = 0 um" in repr(found)


def test_two_points_five_micrometres_apart(projector):
    frame = counted(projector, [(6, 22, 20), (6, 22, 24)])
    found = deconvolve(frame, projector, iterations=30).volume
    row = found[6, 22] / found[6, 22].max()
    assert row[22] < 0.2  # reference .11
    assert row[20] > 0.9
    assert row[24] > 0.9
    assert found[6].sum() > 0.97 * found.sum()  # reference .986


def test_background_white_and_series(projector):
    voxels = [(2, 22, 22)]
    white = 1 - 0.4 * np.random.default_rng(2).random(projector.frame_shape).astype(np.float32)
    white[100:103, 40] = 0
    frame = counted(projector, voxels)
    seen = np.random.default_rng(3).poisson(white * frame + 5.0)
    seen[100:103, 40] = 65535  # saturated, and left out
    series = np.stack([seen, 2 * seen])
    found = deconvolve(series, projector, iterations=10, background=5, white=white)
    assert found.volume.shape == (2, *projector.volume_shape)
    assert found.volume[0, 2].sum() > 0.93 * found.volume[0].sum()
    assert found.volume[0].sum(dtype=float) == pytest.approx(2e6, rel=0.05)
    without = deconvolve(seen, projector, iterations=10, white=white)
    assert without.volume[2].sum() < 0.9 * without.volume.sum()
    again = deconvolve(
        seen, projector, iterations=9, background=5, white=white, start=found.volume[0],
        residual=1.0,
    )  # fmt: skip
    assert again.iterations == 1


def test_acceleration(projector):
    """Twelve iterations go as far as twenty."""
    frame = counted(projector, [(6, 22, 18), (6, 22, 26), (2, 15, 22)])
    plain = deconvolve(frame, projector, iterations=24)
    quick = deconvolve(np.stack([frame, 2 * frame]), projector, iterations=13, accelerate=True)
    assert quick.residuals[0, 12] < plain.residuals[20]
    assert (np.diff(quick.residuals[0]) < 0).all()
    # every frame has its own step, and that does not depend on how bright it is
    assert quick.residuals[1] == pytest.approx(quick.residuals[0], rel=1e-2)
    assert quick.volume[0].sum(dtype=float) == pytest.approx(2e6, rel=0.05)


def test_bad_input(device, projector):
    frame = np.ones(projector.frame_shape)
    with pytest.raises(ShapeError, match="A frame has shape"):
        deconvolve(frame[1:], projector)
    frame[3, 4:6] = -1
    with pytest.raises(ValueError, match="A frame has 2 negative or not finite"):
        deconvolve(frame, projector)
    with pytest.raises(ValueError, match="black"):
        deconvolve(0 * np.abs(frame), projector)
    with pytest.raises(ValueError, match="from 1 on"):
        deconvolve(np.abs(frame), projector, iterations=0)
    few = Projector(projector.images, (9, 4), device=device)
    with pytest.raises(ShapeError, match="9 x 4 lenslets; at least 5 x 5"):
        deconvolve(np.ones(few.frame_shape), few)
