"""Settings of a deconvolution by Python, jobs and commands; what frames of one camera share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from clplen.batch.jobs.tables import DeconvolveTable
from clplen.batch.work import volume_products
from clplen.cli import main
from clplen.cli.microscopy.deconvolve import _jobs
from clplen.compute.device import Device
from clplen.config.setting_tables import take_settings
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy import DeconvolutionSettings, Deconvolver, pipeline
from clplen.microscopy.frames.prepare import Preparation
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.pipeline import provenance
from clplen.microscopy.series.starts import Start
from clplen.microscopy.series_files import Page
from clplen.microscopy.settings import FRAME_SETTINGS, LatticeSettings
from clplen.settings.declaration import settings_of

ALL = DeconvolutionSettings(7, 3.0, 2.0, 900.0, True, 0.25, True, "tv", 0.5)
N = 4


def images(value: float = 1.0) -> PointImages:
    """One plane, one voxel and 4 x 4 pixels a lenslet."""
    stored = (np.full((1, N, N), value, np.float32),)
    about = {"lenslet_pitch": 1e-4, "magnification": 10.0}
    return PointImages(about, np.zeros(1), 1, N, stored, np.ones(1))


def lenslets(levels: Any) -> Any:
    """Frames whose lenslets are evenly bright."""
    return np.kron(levels, np.ones((N, N))).astype(np.float32)


def preparation_of(device: Device, level: Any) -> Preparation:
    """Of pixels 1.25 times as wide as those of the camera."""
    step = 1.25 * N
    shape = tuple(int(1.25 * n) for n in level.shape)
    lattice = Lattice("square", (2, 2), (step, 0), (0, step), shape)
    return Preparation(N, device, None, lattice, np.ones_like(level), level)


def test_haze_is_that_of_the_darkest_lenslets(device: Device) -> None:
    white = lenslets(np.linspace(3, 1, 20).reshape(4, 5))
    share = lenslets(np.arange(21.0, 1, -1).reshape(4, 5))  # of the 20 lenslets 2 to 21
    prepare = preparation_of(device, white)
    # 5 % of 19 steps lie .95 above the least
    assert np.allclose(prepare.haze(white * share, np.ones_like(white)), 2.95 * white)
    known = np.ones_like(white)
    known[::2] = 0  # whatever pixels hold that are left out
    counts = np.where(known > 0, white * share, 0)
    assert np.allclose(prepare.haze(counts, known), 2.95 * white)
    assert not prepare.haze(counts, 0 * known).any()
    assert not prepare.haze(-counts, known).any()


def test_what_is_darker_than_the_dark_frame_is_0_and_counted(device: Device) -> None:
    dark = np.full((N, 2 * N), 5, np.float32)
    frame = dark + np.arange(2 * N) - 3
    frame[1, 7] = np.inf
    found = Preparation(N, device, dark, None, None)(frame)
    assert (found.negative, found.left_out) == (3 * N, 1)
    assert np.array_equal(found.counts[0], [0, 0, 0, 0, 1, 2, 3, 4])
    assert np.argwhere(found.white == 0).tolist() == [[1, 7]]


def test_every_word_arrives(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    level = lenslets(np.arange(25.0).reshape(5, 5) + 1)
    prepare = preparation_of(device, level)
    monkeypatch.setattr(pipeline, "preparation", lambda *a, **k: prepare)
    monkeypatch.setattr(pipeline, "deconvolve", lambda *a, **k: (a, k))
    series = Deconvolver(images(), replace(ALL, haze=False), device=device)
    object.__setattr__(series, "how", ALL)  # haze needs a white frame, and this level is one
    even = 3.0 * 1.25**2 / 2.0  # background, area of a pixel, gain
    light = 2 * (0.5 * level + even)
    frame = SimpleNamespace(counts=light, white=np.where(level == 7, 0, 1))
    before = np.array([[[0.0, 2.0]]], np.float32)
    (counts, projector), given = series(frame, start=before)  # type: ignore[arg-type, misc]
    assert projector.shape == (5, 5)
    assert np.allclose(counts, light / 2)
    assert np.allclose(given["background"], even + 0.5 * level, rtol=1e-5)
    assert np.array_equal(given["start"], np.array([[[1e-3, 2.0]]], np.float32))
    assert given["white"] is frame.white
    assert given["variance"] == prepare.variance
    for name in ("iterations", "residual", "accelerate", "prior", "strength"):
        assert given[name] == getattr(ALL, name)
    monkeypatch.setattr("clplen.microscopy.diagnostics.diagnose_volume", lambda *words, **_: words)
    _, seen, dim, known, n, ratio = series.diagnose(frame, SimpleNamespace(residuals=[]))  # type: ignore[arg-type, misc]
    assert seen is frame
    assert known is level
    assert (n, ratio) == (N, 2 * prepare.variance)
    assert np.allclose(dim, 2 * given["background"])  # in counts, as the frame


def test_jobs_and_commands_know_the_same_settings() -> None:
    table = DeconvolveTable(psf="psf.h5", gain=2, prior="tv", offset=[3, 4], pitch=9)
    values = table.model_dump()
    how, beside = (take_settings(one, values) for one in (DeconvolutionSettings, LatticeSettings))
    assert values == {"psf": "psf.h5"}
    assert how == DeconvolutionSettings(gain=2, prior="tv")
    assert beside == LatticeSettings(pitch=9, offset=(3, 4))
    options = {
        one.name: one for one in main.get_command(None, "microscope").commands["deconvolve"].params
    }  # type: ignore[union-attr, arg-type]
    for one in (*settings_of(DeconvolutionSettings), *settings_of(LatticeSettings)):
        assert options[one.name].default == one.default
        assert DeconvolveTable.model_fields[one.key].default == one.default


def test_a_changed_file_is_read_again(
    tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = {name: tmp_path / name for name in ("psf", "white", "dark")}
    for path in paths.values():
        path.write_bytes(b"1")
    made: list[Any] = []
    monkeypatch.setattr(volume_products, "read_psf", lambda path: path)
    monkeypatch.setattr(
        volume_products, "Deconvolver", lambda *a, **k: made.append((a, k)) or made[-1]
    )
    resources: Any = SimpleNamespace(deconvolver=None, device=device, memory=8)

    def kept(how: DeconvolutionSettings = ALL) -> Any:
        return volume_products._cached_deconvolver(
            resources, {name: str(path) for name, path in paths.items()}, how
        )

    assert kept() is kept()
    for number, path in enumerate(paths.values()):
        path.write_bytes(b"22")
        assert kept() is kept()
        assert len(made) == number + 2
    kept(replace(ALL, iterations=8))
    assert len(made) == 5


def test_what_a_volume_depends_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another word, file, number, way to begin or version is another job."""
    files = [tmp_path / name for name in "abc"]
    for path in files:
        path.write_bytes(path.name.encode())
    other = DeconvolutionSettings(
        8, 4.0, 3.0, 901.0, False, "noise", False, "gaussian", 0.6, True, True
    )
    hows = [
        ALL,
        *(replace(ALL, **{name: getattr(other, name)}) for name in FRAME_SETTINGS),
    ]

    def job(how: DeconvolutionSettings = ALL, page: int = 0, **changed: Any) -> str:
        given: dict[str, Any] = {"images": images(), "white": files[1], "dark": files[2]}
        given |= changed
        begin = Start(given.pop("start", None), given["images"], motion=1e-6)
        pages = [Page(files[0], number) for number in range(2)]
        return repr(_jobs(pages, provenance(how=how, **given), begin)[page])

    found = [job(how) for how in hows]
    found += [job(images=images(2.0)), job(white=files[2]), job(white=None), job(dark=files[1])]
    found += [job(dark=None), job(page=1)]
    found += [job(page=1, start=name) for name in ("previous", "decayed", "limited")]
    found.append(job(page=1, start="previous", dark=None))  # all before it are others
    files[0].write_bytes(b"changed")
    found.append(job())
    monkeypatch.setattr("clplen.__version__", "another")
    found.append(job())
    assert len(set(found)) == len(found)
