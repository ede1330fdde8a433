"""stereo on the command line: which eye sees which view."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from command_line import done, refused
from command_line import invoke_on as run

import clplen
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.io import anaglyph


def test_eyes(tmp_path: Path, device: Device) -> None:
    v, u = np.indices((3, 5))
    levels = (40 * (u + 1) + v).astype(np.uint8)
    samples = np.broadcast_to(levels[..., None, None], (3, 5, 22, 31))
    np.save(tmp_path / "views.npy", samples)
    clplen.io.write_pfm(tmp_path / "map.pfm", np.zeros((22, 31), np.float32))
    out = tmp_path / "out.png"
    words = ["stereo", tmp_path / "views.npy", "-o", out, "--disparity", tmp_path / "map.pfm"]
    for more, ends in (
        (("--kind", "side-by-side"), (41, 201)),
        (("--kind", "cross-eyed"), (201, 41)),
        (("--kind", "side-by-side", "--baseline", 2), (81, 161)),
    ):
        done(run(device, *words, *more))
        found = imageio.imread(out)
        assert found.shape == (22, 62)
        assert (found[3, 3], found[18, 58]) == ends
    done(run(device, *words, "--colours", "colour"))
    assert imageio.imread(out)[5, 5].tolist() == [41, 201, 201]
    assert "at most 4 view steps" in refused(run(device, *words, "--baseline", 4.5))


def test_anaglyphs() -> None:
    grey = np.full((3, 4), 130, np.uint8)
    for colours in ("dubois", "colour", "grey"):
        np.testing.assert_allclose(anaglyph(grey, grey, colours=colours), 130, atol=1)
    red = np.zeros((3, 4, 3), np.uint8)
    red[..., 0] = 255  # Dubois 2009: 0.437 of linear red to the left eye
    assert anaglyph(red, 0 * red)[0, 0].tolist() == [177, 0, 0]
    with pytest.raises(ShapeError):
        anaglyph(grey, grey[1:])
    with pytest.raises(ValueError, match="uint8"):
        anaglyph(grey * 1.0, grey * 1.0)
