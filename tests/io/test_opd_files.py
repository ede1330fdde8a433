"""Files of OPD maps: HDF5, beside raw images and light fields, and listings of Zemax."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from clplen import FormatError, LightField, MicrolensArray, PlenopticCamera, PointSources
from clplen.cameras import Aberrations, OPDMaps
from clplen.compute.device import Device
from clplen.io import read_lightfield, read_opd_maps, read_raw, read_zemax_opd, write_opd_maps
from clplen.io.formats.zemax_map import read_zemax_map

RNG = np.random.default_rng(3)
LAM = 546.1e-9


def disc(n_v: int, n_u: int) -> tuple[Any, Any, Any]:
    v, u = np.meshgrid(np.linspace(-1, 1, n_v), np.linspace(-1, 1, n_u), indexing="ij")
    return v, u, np.where(np.hypot(v, u) <= 1 + 1e-12, 1.0, np.nan)


def maps() -> OPDMaps:
    """Everything given, nothing alike."""
    v, u, inside = disc(23, 19)
    path = 1e-7 * inside * (v**2 - 0.3 * u + 0.1 * u * v) * RNG.random((2, 3, 1, 1))
    return OPDMaps(
        path, fields=[0, 1e-3, 2e-3], wavelengths=[LAM, 480e-9], symmetric=True,
        transmission=np.clip(1.1 - 0.2 * np.abs(v), 0, 1) * np.ones((3, 1, 1)),
        distortion=[(0, 0), (1e-5, 0), (3e-5, -1e-6)], pupil_shift=0.1 * RNG.random((2, 3, 2)),
        pupil_distance=0.11, pupil_diameter=0.02,
    )  # fmt: skip


def test_hdf5_gives_the_same_back(tmp_path: Path) -> None:
    given, path = maps(), tmp_path / "lens.h5"
    given.save(path)
    found = read_opd_maps(path)
    assert found == given
    assert (found.pupil_distance, found.symmetric) == (0.11, True)
    plain = OPDMaps(given.paths[:1, :1], fields=[(0, 0)])
    write_opd_maps(path, plain)
    assert read_opd_maps(path) == plain
    with pytest.raises(ValueError, match=r"must end in \.h5 .* got .*lens\.npz"):
        given.save(tmp_path / "lens.npz")


def test_cameras_keep_their_maps(tmp_path: Path, device: Device) -> None:
    mla = MicrolensArray(150e-6, 10e-3, count=9, fill="full")
    bad = Aberrations(main_lens={4: 1e-8}, main_lens_opd=maps())
    camera = PlenopticCamera.type1(
        focal_length=0.12, mla=mla, wavelength=500e-9, pixels_per_lenslet=12,
        aperture_diameter=1e-3, aberrations=bad, device=device,
    )  # fmt: skip
    raw = camera.expose(PointSources((0, 0, 0)))
    raw.save(tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5", device=device)
    assert again.camera is not None
    assert again.camera.aberrations == bad  # type: ignore[attr-defined]
    assert read_opd_maps(tmp_path / "raw.h5") == bad.main_lens_opd
    lf = LightField.from_raw(raw)
    for name in ("lf.h5", "lf.zarr"):
        lf.save(tmp_path / name)
        assert read_lightfield(tmp_path / name, device=device).camera.aberrations == bad
    with h5py.File(tmp_path / "raw.h5", "a") as file:
        del file["camera/opd"]
    with pytest.raises(FormatError, match="main_lens_opd must be the OPD maps"):
        read_raw(tmp_path / "raw.h5", device=device)


def test_damaged_files(tmp_path: Path) -> None:
    for change, said in [
        (lambda group: group.pop("fields"), "have no array 'fields'"),
        (lambda group: group["path"].write_direct(np.full((2, 3, 23, 19), 0.3)), "invalid: path"),
        (lambda group: group.attrs.update(pupil_distance=-1.0), "pupil_distance must be positive"),
    ]:
        path = tmp_path / "lens.h5"
        maps().save(path)
        with h5py.File(path, "a") as file:
            change(file["opd"])
        with pytest.raises(FormatError, match=said):
            read_opd_maps(path)


def test_files_that_hold_no_maps(tmp_path: Path) -> None:
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["x"] = np.ones(3)
        file.create_dataset("opd/path", (10**4, 10**4, 10**3, 10**3), "f8", chunks=(1, 1, 99, 99))
        file["opd/fields"] = np.ones((10**4, 2))
    with pytest.raises(FormatError, match=r"declares|needs"):
        read_opd_maps(path)
    with h5py.File(path, "a") as file:
        del file["opd"]
    with pytest.raises(FormatError, match=r"\(group 'opd'\); it has x"):
        read_opd_maps(path)


# Zemax


def waves(v: Any, u: Any, field: float = 1.0) -> Any:
    """An OPD that differs along both axes, in waves."""
    return field * (0.4 * v - 0.1 * u + 0.3 * v**2 * u - 0.2 * u**4)


def listing(n: int, *, lam: str = "0.5461 \u00b5m", field: float = 1.0, row: int = 0) -> str:
    """What OpticStudio saves: the first row is the largest y; even grids have a rim too many."""
    half = n // 2 - 1 if n % 2 == 0 else n // 2
    column, row = (n // 2 + 1, row or (n // 2 if n % 2 == 0 else n // 2 + 1))
    y = (row - 1 - np.arange(n)[:, None]) / half
    x = (np.arange(n) - column + 1) / half
    lit = (np.hypot(y, x) <= 1 + 1e-12) & (y < 0.8)
    values = np.where(lit, waves(y, x, field), 0.0)
    head = [
        "Listing of Wavefront Map Data", "", "File : C:\\LENS.ZMX", "Title: A lens, 50 by 50",
        "Date : 9/19/2018", "", "Wavefront Function", f"{lam} at 0.0000, 14.0000 (deg).",
        "Peak to valley = 1.2821 waves, RMS = 0.2036 waves.", "Surface: Image",
        "Exit Pupil Diameter: 1.0230E+01 Millimeters", f"Pupil grid size: {n} by {n}",
        f"Center point is: Col {column}, Row {row}", "",
    ]  # fmt: skip
    rows = ["\t".join(f"{value: .6E}" for value in line) for line in values]
    return "\r\n".join(head + rows) + "\r\n"


def test_listings_of_zemax(tmp_path: Path) -> None:
    for n, encoding, lam in [
        (32, "utf-16", "0.5461 \u00b5m"),
        (31, "utf-16-le", "0.5461 \u03bcm"),
        (33, "utf-8", "0.5461 um"),
        (64, "utf-8-sig", "0.5461 \u00b5m"),
        (16, "utf-16-be", "0.5461 \u00b5m"),
        (32, "latin-1", "0.5461 \u00b5m"),
    ]:
        path = tmp_path / "map.txt"
        mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
        path.write_bytes(mark + listing(n, lam=lam).encode(encoding))
        found = read_zemax_map(path)
        side = n - 1 if n % 2 == 0 else n
        v, u, _ = disc(side, side)
        expected = np.where((np.hypot(v, u) <= 1 + 1e-12) & (v < 0.8), -waves(v, u) * LAM, np.nan)
        assert found.path.shape == (side, side)
        assert np.array_equal(np.isnan(found.path), np.isnan(expected))
        assert np.nanmax(np.abs(found.path - expected)) <= 2e-6 * LAM
        assert found.wavelength == pytest.approx(LAM)
        assert found.field == "0.0000, 14.0000 (deg)"
        assert found.pupil_diameter == pytest.approx(10.23e-3)


def test_maps_of_listings(tmp_path: Path) -> None:
    files = []
    for lam in ("0.5461 um", "0.4800 um"):
        row = []
        for field in (1.0, 1.5, 2.5):
            row.append(tmp_path / f"{lam[:6]}-{field}.txt")
            row[-1].write_text(listing(32, lam=lam, field=field), encoding="utf-16")
        files.append(row)
    found = read_zemax_opd(
        files, fields=[0, 1e-3, 3e-3], symmetric=True, pupil_distance=0.05,
        distortion=[(0, 0), (1e-6, 0), (5e-6, 0)],
    )  # fmt: skip
    v, u = RNG.uniform(-0.6, 0.6, (2, 40))
    exact = -waves(v, u, 2.0) * LAM  # linear in the field
    assert np.abs(found.path(2e-3, 0, LAM, v, u) - exact).max() <= 1e-4 * np.abs(exact).max()
    assert found.transmission(3e-3, 0, LAM, 0.95, 0) == 0
    assert found.pupil_diameter == pytest.approx(10.23e-3)
    one = read_zemax_opd(files[0][:1], fields=[(0, 0)])
    assert one.paths.shape == (1, 1, 31, 31)
    with pytest.raises(FormatError, match=r"got 546\.1, 480 nm .*: sort"):
        read_zemax_opd([files[0][0], files[1][0]], fields=[0, 1e-3], symmetric=True)
    with pytest.raises(ValueError, match="equally many for each"):
        read_zemax_opd([files[0], files[1][:2]], fields=[0, 1e-3], symmetric=True)
    files[0][1].write_text(listing(33, field=1.5))
    with pytest.raises(FormatError, match="same sampling, got 31 x 31, 33 x 33"):
        read_zemax_opd(files, fields=[0, 1e-3, 3e-3], symmetric=True)


def test_listings_that_are_damaged(tmp_path: Path) -> None:
    for change, said in [
        (lambda text: "Listing of PSF\n", "no line 'Pupil grid size"),
        (lambda text: text.replace("um at", "for"), r"no line '... um at ...'"),
        (lambda text: text[: len(text) // 2], "has .* rows of 32 numbers"),
        (lambda text: text.replace("E+00", "E+x0", 40), "truncated or damaged"),
        (lambda text: text.replace("Row 16", "Row 9"), "must extend from rim to rim"),
        (lambda text: text.replace("32 by 32", "999999 by 999999"), "999999 by 999999"),
    ]:
        path = tmp_path / "map.txt"
        path.write_text(change(listing(32, lam="0.5461 um")))
        with pytest.raises(FormatError, match=said):
            read_zemax_map(path)
        with pytest.raises(FormatError, match="There is no file"):
            read_zemax_map(tmp_path / "none.txt")


def test_a_listing_far_longer_than_its_grid(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(listing(16) + "0.5\n" * 100_000)
    with pytest.raises(FormatError, match=r"far more than its 16 by 16 numbers need"):
        read_zemax_map(path)
