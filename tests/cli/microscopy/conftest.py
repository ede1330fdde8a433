"""Point images that tests of ``clplen microscope`` share."""

from __future__ import annotations

from pathlib import Path

import pytest
from microscope_commands import KNOWN, done, run

from clplen.compute.device import Device


@pytest.fixture(scope="session")
def psf(tmp_path_factory: pytest.TempPathFactory, device: Device) -> Path:
    """Point images on three planes, by the names of LFAnalyze in known.toml beside them."""
    folder = tmp_path_factory.mktemp("psf")
    (folder / "known.toml").write_text(KNOWN)
    words = ("-o", folder / "psf.h5", "--cut", 0.02, "--device", device.place)
    result = done(run("psf", folder / "known.toml", *words))
    assert "3 planes, 3 x 3 voxels and 15 x 15 pixels a lenslet" in result.output
    return folder / "psf.h5"
