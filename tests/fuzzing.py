"""Small good files of every format, damaged on purpose, and what may come of reading them."""

from __future__ import annotations

import json
import random
import re
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
import tifffile

from clplen.compute.device import Device
from clplen.config import read_camera_file
from clplen.errors import FormatError, ShapeError
from clplen.io import read_lightfield, read_picture, read_raw, write_lightfield
from clplen.io.hci import read_parameters
from clplen.io.pfm import read_pfm, write_pfm
from clplen.io.picture import write_picture
from clplen.io.positions import read_positions
from clplen.io.raw import read_frame
from clplen.io.raytrix import write_raytrix
from clplen.io.raytrix_calibration import FocusType, RaytrixCalibration
from clplen.io.volume import read_volume, write_volume
from clplen.io.zarrs import write_zarr
from clplen.lightfield.lattice import Lattice
from clplen.lightfield.lightfield import LightField
from clplen.microscopy import psffile
from clplen.microscopy.images import PointImages

# Errors that a damaged file may cause: its own, and those of a value that makes no light field.
ALLOWED = (FormatError, ShapeError, ValueError)
SLACK = 64 << 20  # bytes, beside 4 times the file
Operation = tuple[int, float, int]  # what, where (0 to 1), with which number

_LENGTHS = (2**32 - 1, 2**31, 2**31 - 1, 0, 1, 2**16, 2**24)
_NUMBERS = (b"-1", b"0", b"999999999999", b"nan", b"1e999", b"", b"[]", b"null")


@dataclass(frozen=True)
class Parser:
    """A reader with one good file.

    Attributes
    ----------
    make : callable
        Writes a good file or folder in a folder and returns its path.
    read : callable
        (path, device).
    """

    make: Callable[[Path, Device], Path]
    read: Callable[[Path, Device], Any]


def mutated(data: bytes, operations: list[Operation]) -> bytes:
    """Bytes, damaged one operation after the other."""
    out = bytearray(data)
    for what, where, number in operations:
        if not out:
            break
        place = int(where * len(out))
        size = 1 + number % 64
        match what % 8:
            case 0:
                del out[place:]
            case 1:
                out[place] ^= 1 << number % 8
            case 2:
                order = "<I" if number % 2 else ">I"
                out[place : place + 4] = struct.pack(order, _LENGTHS[number // 2 % len(_LENGTHS)])
            case 3:
                other = number % len(out)
                first, second = bytes(out[place : place + size]), bytes(out[other : other + size])
                out[place : place + size], out[other : other + size] = second, first
            case 4:
                del out[place : place + size]
            case 5:
                out[place:place] = out[number % len(out) :][:size]
            case 6:
                found = list(re.finditer(rb"-?\d+(?:\.\d+)?", bytes(out[:100000])))
                if found:
                    start, end = found[int(where * len(found))].span()
                    out[start:end] = _NUMBERS[number % len(_NUMBERS)]
            case _:
                out[place] = number % 256
    return bytes(out)


def operations(source: random.Random) -> list[Operation]:
    """One to four random operations."""
    return [
        (source.randrange(8), source.random(), source.randrange(1 << 32))
        for _ in range(source.randint(1, 4))
    ]


def damage(path: Path, ops: list[Operation], source: random.Random) -> bytes:
    """Damage a file, or one file of a folder, and return what it is now."""
    file = path
    if path.is_dir():
        file = source.choice(sorted(f for f in path.rglob("*") if f.is_file()))
    data = mutated(file.read_bytes(), ops)
    if data[:4] == b"\x89PNG" and source.random() < 0.7:
        data = with_checksums(data)
    file.write_bytes(data)
    return data


def with_checksums(data: bytes) -> bytes:
    """A PNG whose chunks have the checksums of what they hold now, to get past these."""
    out, place = bytearray(data), 8
    while place + 12 <= len(out):
        end = place + 8 + int.from_bytes(out[place : place + 4], "big")
        if end + 4 > len(out):
            break
        out[end : end + 4] = zlib.crc32(out[place + 4 : end]).to_bytes(4, "big")
        place = end + 4
    return bytes(out)


def size_of(path: Path) -> int:
    """Bytes of a file, or of all files of a folder."""
    if path.is_dir():
        return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    return path.stat().st_size


def outcome(parser: Parser, path: Path, device: Device) -> tuple[str, int]:
    """What reading gives, and the largest memory that Python and numpy held meanwhile.

    Raises whatever is not allowed.
    """
    tracemalloc.start()
    try:
        parser.read(path, device)
        said = "read"
    except ALLOWED as error:
        if type(error) not in ALLOWED or not str(error):
            raise
        said = type(error).__name__
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return said, peak


def light_field(device: Device, *, dtype: Any = np.uint8, colour: bool = True) -> LightField:
    """2 x 3 views of 5 x 4 pixels."""
    shape = (2, 3, 5, 4, 3) if colour else (2, 3, 5, 4)
    values = np.random.default_rng(3).integers(0, 200, shape).astype(dtype)
    return LightField.from_array(values, device=device, spacing=(-1e-3, -1e-3, 1e-4, 1e-4))


def _lfp(folder: Path, _: Device) -> Path:
    frame = np.arange(60).reshape(5, 12)
    raw = bytes(range(90))
    image = {
        "width": frame.shape[1],
        "height": frame.shape[0],
        "pixelPacking": {"bitsPerPixel": 12, "endianness": "big"},
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": "b"},
    }
    names = [b"sha1-" + letter * 40 for letter in (b"a", b"b")]
    refs = {"imageRef": names[0].decode(), "metadataRef": names[1].decode()}
    table = json.dumps({"picture": {"frameArray": [{"frame": refs}]}}).encode()
    out = b"\x89LFP\r\n\x1a\n\0\0\0\1" + bytes(4)
    parts = (b"M", b"sha1-" + b"t" * 40, table), (b"C", names[0], raw)
    for letter, name, data in (*parts, (b"C", names[1], json.dumps({"image": image}).encode())):
        out += b"\x89LF" + letter + b"\r\n\x1a\n" + bytes(4) + struct.pack(">I", len(data))
        out += name + bytes(35) + data
        out += bytes(-len(out) % 16)
    (folder / "a.lfp").write_bytes(out)
    return folder / "a.lfp"


def _described(folder: Path, _: Device) -> Path:
    (folder / "a.raw").write_bytes(bytes(range(60)))
    packed = {"bitsPerPixel": 16, "endianness": "little"}
    image = {"width": 6, "height": 5, "pixelPacking": packed}
    (folder / "a.json").write_text(json.dumps({"image": image}))
    return folder / "a.json"


def _raytrix(folder: Path, _: Device) -> Path:
    types = tuple(FocusType((x, 0), (1, 3)) for x in (0, 1, -1))
    base = ((1, 0), (0.5, -(0.75**0.5)))
    rectangle = (3, -(3**0.5))
    found = RaytrixCalibration((1, 2), 6, *base, 0.01, 1, 2, rectangle, None, types)
    write_raytrix(folder / "a.xml", found)
    write_picture(folder / "a.png", np.zeros((40, 50), np.uint8))
    return folder / "a.xml"


def _pfm(folder: Path, _: Device) -> Path:
    write_pfm(folder / "a.pfm", np.ones((5, 4, 3), np.float32))
    return folder / "a.pfm"


def _npy(folder: Path, device: Device) -> Path:
    np.save(folder / "a.npy", light_field(device).to_numpy())
    return folder / "a.npy"


def _hdf5(folder: Path, device: Device) -> Path:
    write_lightfield(folder / "a.h5", light_field(device, dtype=np.uint16))
    return folder / "a.h5"


def _hci2013(folder: Path, device: Device) -> Path:
    with h5py.File(folder / "lf.h5", "w") as file:
        file.create_dataset("LF", data=light_field(device).to_numpy(), compression="gzip")
        file.create_dataset("GT_DEPTH", data=np.ones((2, 3, 5, 4), np.float32))
        file.attrs.update({"dH": 0.1, "focalLength": 9.0, "shift": 0.2})
    return folder / "lf.h5"


def _mat5(folder: Path, device: Device) -> Path:
    values = light_field(device, dtype=np.uint16).to_numpy()
    scipy.io.savemat(folder / "a.mat", {"LF": values, "name": "x"}, do_compression=True)
    return folder / "a.mat"


def _zarr(folder: Path, device: Device) -> Path:
    write_zarr(folder / "a.zarr", light_field(device))
    return folder / "a.zarr"


def _views(folder: Path, device: Device) -> Path:
    write_lightfield(folder / "views", light_field(device))
    return folder / "views"


def _tiff_views(folder: Path, device: Device) -> Path:
    write_lightfield(folder / "views", light_field(device, dtype=np.float32))
    return folder / "views"


def _zip(folder: Path, device: Device) -> Path:
    views = _views(folder, device)
    with zipfile.ZipFile(folder / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(views.iterdir()):
            archive.write(file, file.name)
    return folder / "a.zip"


def _png(folder: Path, _: Device) -> Path:
    write_picture(folder / "a.png", np.arange(300, dtype=np.uint8).reshape(10, 10, 3))
    return folder / "a.png"


def _png16(folder: Path, _: Device) -> Path:
    write_picture(folder / "a.png", np.arange(100, dtype=np.uint16).reshape(10, 10))
    return folder / "a.png"


def _tiff(folder: Path, _: Device) -> Path:
    values = np.arange(4 * 99, dtype=np.uint16).reshape(4, 9, 11)
    tifffile.imwrite(folder / "a.ome.tif", values, metadata={"axes": "TYX"}, compression="zlib")
    return folder / "a.ome.tif"


def _mosaic(folder: Path, device: Device) -> Path:
    values = light_field(device).to_numpy().transpose(2, 0, 3, 1, 4).reshape(10, 12, 3)
    write_picture(folder / "a.png", values)
    return folder / "a.png"


def _grid(folder: Path, _: Device) -> Path:
    Lattice("hexagonal", (20.5, 30.25), (7, 0.1), (-0.1, 8), (41, 66)).save(folder / "a.json")
    return folder / "a.json"


def _calinfo(folder: Path, _: Device) -> Path:
    names = ("HSpacing", "VSpacing", "HOffset", "VOffset", "Rot", "FirstPosShiftRow")
    model = dict(zip(names, (10.0, 8.66, 3.1, 4.2, 0.001, 2), strict=True))
    (folder / "a.json").write_text(json.dumps({"LensletGridModel": model}))
    return folder / "a.json"


def _parameters(folder: Path, _: Device) -> Path:
    text = (
        "[intrinsics]\nfocal_length_mm = 100\nimage_resolution_x_px = 512\n"
        "image_resolution_y_px = 512\nsensor_size_mm = 35\nfstop = 100\n"
        "[extrinsics]\nnum_cams_x = 9\nnum_cams_y = 9\nbaseline_mm = 15.0\n"
        "focus_distance_m = 3.6\ncenter_cam_x_m = 0.1\ncenter_cam_y_m = -1.3\n"
        "[meta]\nscene = x\ncategory = training\nversion = v0\ndisp_min = -1.5\ndisp_max = 1.5\n"
    )
    (folder / "parameters.cfg").write_text(text)
    return folder / "parameters.cfg"


def _positions(folder: Path, _: Device) -> Path:
    rows = [f"{v},{u},{v + 0.01},{u - 0.02}" for v in range(2) for u in range(3)]
    (folder / "a.csv").write_text("\n".join(["v,u,y,x", *rows]) + "\n")
    return folder / "a.csv"


def _camera(folder: Path, _: Device) -> Path:
    from clplen.config.example import EXAMPLE

    (folder / "a.toml").write_text(EXAMPLE)
    return folder / "a.toml"


def _volume(name: str) -> Callable[[Path, Device], Path]:
    def made(folder: Path, _: Device) -> Path:
        values = np.arange(4 * 99, dtype=np.float32).reshape(4, 9, 11)
        planes = np.array([0.0, 1, 2, 3]) * 1e-6
        write_volume(folder / name, values, planes=planes, voxel=(1e-6, 1e-6))
        return folder / name

    return made


def _point_images(folder: Path, _: Device) -> Path:
    stored = (np.ones((1, 3, 3), np.float32), np.ones((1, 9, 9), np.float32))
    about = {"planes": (0.0, 1e-6), "voxels_per_lenslet": 1, "pixels_per_lenslet": 3}
    images = PointImages(about, np.array([0.0, 1e-6]), 1, 3, stored, np.ones(2))
    psffile.write(folder / "a.h5", images)
    return folder / "a.h5"


def _lightfield(**layout: Any) -> Callable[[Path, Device], Any]:
    return lambda path, device: read_lightfield(path, device=device, **layout)


PARSERS = {
    "lfp": Parser(_lfp, lambda path, _: read_frame(path)),
    "described": Parser(_described, lambda path, _: read_frame(path)),
    "raytrix": Parser(_raytrix, lambda path, device: read_raw(path, device=device)),
    "pfm": Parser(_pfm, lambda path, _: read_pfm(path)),
    "npy": Parser(_npy, _lightfield()),
    "hdf5": Parser(_hdf5, _lightfield()),
    "hci2013": Parser(_hci2013, _lightfield()),
    "mat5": Parser(_mat5, _lightfield()),
    "zarr": Parser(_zarr, _lightfield()),
    "zip": Parser(_zip, _lightfield()),
    "views": Parser(_views, _lightfield(allow_missing=True)),
    "tiff-views": Parser(_tiff_views, _lightfield()),
    "png": Parser(_png, lambda path, _: read_picture(path)),
    "png16": Parser(_png16, lambda path, _: read_picture(path)),
    "tiff": Parser(_tiff, lambda path, _: read_frame(path, frame=2)),
    "mosaic": Parser(_mosaic, _lightfield(views=(2, 3), order="yvxu")),
    "grid": Parser(_grid, lambda path, _: Lattice.load(path)),
    "calinfo": Parser(_calinfo, lambda path, _: Lattice.load(path)),
    "parameters": Parser(_parameters, lambda path, _: read_parameters(path)),
    "positions": Parser(_positions, lambda path, _: read_positions(path, (2, 3))),
    "camera": Parser(_camera, lambda path, _: read_camera_file(path)),
    "volume": Parser(_volume("a.ome.tif"), lambda path, _: read_volume(path)),
    "zarr-volume": Parser(_volume("a.ome.zarr"), lambda path, _: read_volume(path)),
    "point-images": Parser(_point_images, lambda path, _: psffile.read(path)),
}
