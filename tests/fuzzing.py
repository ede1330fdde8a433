"""Small good files of every format, and what may come of reading them when they are damaged."""

from __future__ import annotations

import json
import shutil
import struct
import tempfile
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
import tifffile

from clplen.cameras import OPDMaps
from clplen.cameras.scenes.ground_truth import Truth
from clplen.compute.device import Device
from clplen.config.camera_file import read_camera_file
from clplen.errors import FormatError, ShapeError
from clplen.io import (
    read_depth,
    read_disparity,
    read_intrinsics,
    read_lightfield,
    read_opd_maps,
    read_picture,
    read_ply,
    read_raw,
    read_scene_truth,
    read_stack,
    read_truth,
    read_zemax_opd,
    write_depth,
    write_intrinsics,
    write_lightfield,
    write_opd_maps,
    write_ply,
    write_stack,
    write_truth,
)
from clplen.io.formats.pfm import read_pfm, write_pfm
from clplen.io.formats.picture import write_picture
from clplen.io.lightfields.container_lightfields import write_container
from clplen.io.lightfields.view_positions import read_positions
from clplen.io.raw.raw_files import read_frame
from clplen.io.raw.raytrix import FocusType, RaytrixCalibration, write_raytrix
from clplen.io.results.hci import read_parameters
from clplen.io.results.volume_files import read_volume, write_volume
from clplen.lightfield.depth.depth_maps import DepthMap
from clplen.lightfield.metric.intrinsics import Intrinsics
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.microscopy.model import point_image_files
from clplen.microscopy.model.images import PointImages

# Errors that a damaged file may cause: its own, and those of a value that makes no light field.
ALLOWED = (FormatError, ShapeError, ValueError)
SLACK = 64 << 20  # bytes, beside 4 times the file


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
        said, _ = attempt(parser, path, device)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return said, peak


def attempt(parser: Parser, path: Path, device: Device) -> tuple[str, Any]:
    """What reading says and gives. Raises whatever is not allowed."""
    try:
        return "read", parser.read(path, device)
    except ALLOWED as error:
        if type(error) not in ALLOWED or not str(error):
            raise
        return type(error).__name__, None


def bytes_of(result: Any, depth: int = 3) -> int:
    """Bytes of the arrays in what reading gives."""
    if hasattr(result, "nbytes"):
        return int(result.nbytes)
    inside = list(result.values()) if isinstance(result, dict) else result
    if not isinstance(inside, list | tuple):
        inside = list(getattr(result, "__dict__", {}).values())
    return sum(bytes_of(part, depth - 1) for part in inside) if depth else 0


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
    write_container(folder / "a.zarr", light_field(device))
    return folder / "a.zarr"


def _zarr3(folder: Path, device: Device) -> Path:
    """Format 3, sharded, and packed in each of the three ways that it knows."""
    import zarr
    from zarr import codecs

    values = light_field(device).to_numpy()
    group = zarr.open_group(str(folder / "a.zarr"), mode="w", zarr_format=3)
    arrays = {
        "lightfield": (values, (1, 1, 5, 4, 3), (1, 3, 5, 4, 3), codecs.BloscCodec(typesize=1)),
        "weights": (np.ones((2, 3), np.float32), (2, 3), None, codecs.ZstdCodec()),
        "positions": (np.zeros((2, 3, 2)), (1, 3, 2), None, codecs.GzipCodec()),
    }
    for name, (array, chunks, shards, codec) in arrays.items():
        words = {"chunks": chunks, "shards": shards, "compressors": codec}
        made = group.create_array(name, shape=array.shape, dtype=array.dtype, **words)
        made[...] = array
    return folder / "a.zarr"


def _packed(make: Callable[[Path, Device], Path]) -> Callable[[Path, Device], Path]:
    """The folder that another function makes, as an archive."""

    def made(folder: Path, device: Device) -> Path:
        with tempfile.TemporaryDirectory() as place:
            inside = make(Path(place), device)
            return Path(shutil.make_archive(str(folder / "a"), "zip", inside))

    return made


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


def _tiff_tiles(folder: Path, _: Device) -> Path:
    values = np.arange(40 * 50 * 3, dtype=np.uint16).reshape(40, 50, 3)
    words = {"tile": (16, 16), "compression": "zlib", "photometric": "rgb", "bigtiff": True}
    tifffile.imwrite(folder / "a.tif", values, predictor=True, **words)
    return folder / "a.tif"


def _depth(name: str) -> Callable[[Path, Device], Path]:
    def made(folder: Path, _: Device) -> Path:
        maps = np.random.default_rng(2).normal(size=(4, 9, 11)).astype(np.float32)
        write_depth(folder / name, DepthMap(*maps))
        return folder / name

    return made


def _truth(folder: Path, _: Device) -> Path:
    maps = np.random.default_rng(2).normal(size=(2, 9, 11)).astype(np.float32)
    masks = {"near": maps[0] > 0}
    write_truth(folder / "a.h5", Truth(maps[0], maps[1], np.zeros((9, 11), np.int32), masks))
    return folder / "a.h5"


def _mosaic(folder: Path, device: Device) -> Path:
    values = light_field(device).to_numpy().transpose(2, 0, 3, 1, 4).reshape(10, 12, 3)
    write_picture(folder / "a.png", values)
    return folder / "a.png"


def _grid(folder: Path, _: Device) -> Path:
    Lattice("hexagonal", (20.5, 30.25), (7, 0.1), (-0.1, 8), (41, 66)).save(folder / "a.json")
    return folder / "a.json"


def _intrinsics(folder: Path, _: Device) -> Path:
    H = np.diag([1e-3, 1e-3, 2e-3, 2e-3, 1.0])
    H[:4, 4] = -H.diagonal()[:4] * (2, 2, 23.5, 15.5)
    write_intrinsics(folder / "a.json", Intrinsics(H, np.full(5, 0.01), (5, 5, 32, 48), 0.02))
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


def _stack(name: str) -> Callable[[Path, Device], Path]:
    def made(folder: Path, device: Device) -> Path:
        values = np.arange(2 * 99, dtype=np.float32).reshape(2, 9, 11)
        stack = FocalStack(device.upload(values), device, np.arange(2.0), np.ones(2))
        write_stack(folder / name, stack)
        return folder / name

    return made


def _ply(folder: Path, _: Device) -> Path:
    write_ply(folder / "a.ply", np.arange(27.0).reshape(9, 3), np.zeros((9, 3), np.uint8))
    return folder / "a.ply"


def _point_images(folder: Path, _: Device) -> Path:
    stored = (np.ones((1, 3, 3), np.float32), np.ones((1, 9, 9), np.float32))
    about = {"planes": (0.0, 1e-6), "voxels_per_lenslet": 1, "pixels_per_lenslet": 3}
    images = PointImages(about, np.array([0.0, 1e-6]), 1, 3, stored, np.ones(2))
    point_image_files.write_point_images(folder / "a.h5", images)
    return folder / "a.h5"


def _opd(folder: Path, _: Device) -> Path:
    v = np.linspace(-1, 1, 9)[:, None]
    maps = OPDMaps(1e-7 * v**2 * np.ones((2, 3, 9, 7)), fields=[0, 1e-3, 2e-3], symmetric=True,
                   wavelengths=(5e-7, 6e-7))  # fmt: skip
    write_opd_maps(folder / "a.h5", maps)
    return folder / "a.h5"


def _zemax(folder: Path, _: Device) -> Path:
    rows = [" ".join(f"{0.1 * i - 0.07 * k + 0.01: .6E}" for k in range(8)) for i in range(8)]
    head = ["0.5876 um at 0.00 (deg)", "Pupil grid size: 8 by 8", "Center point is: Col 5, Row 4"]
    (folder / "a.txt").write_text("\n".join([*head, "", *rows]), encoding="utf-16")
    return folder / "a.txt"


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
    "zarr-zip": Parser(_packed(_zarr), _lightfield()),
    "zarr3": Parser(_zarr3, _lightfield()),
    "zarr3-zip": Parser(_packed(_zarr3), _lightfield()),
    "zip": Parser(_zip, _lightfield()),
    "views": Parser(_views, _lightfield(allow_missing=True)),
    "tiff-views": Parser(_tiff_views, _lightfield()),
    "png": Parser(_png, lambda path, _: read_picture(path)),
    "png16": Parser(_png16, lambda path, _: read_picture(path)),
    "tiff": Parser(_tiff, lambda path, _: read_frame(path, frame=2)),
    "tiff-tiles": Parser(_tiff_tiles, lambda path, _: read_picture(path)),
    "ome-depth": Parser(_depth("a.ome.tif"), lambda path, _: read_disparity(path)),
    "zarr-depth": Parser(_depth("a.zarr"), lambda path, _: read_disparity(path)),
    "truth": Parser(_truth, lambda path, _: read_truth(path)),
    "scene-truth": Parser(_truth, lambda path, _: read_scene_truth(path)),
    "depth": Parser(_depth("a.ome.tif"), lambda path, _: read_depth(path)),
    "stack": Parser(_stack("a.ome.tif"), lambda path, device: read_stack(path, device=device)),
    "zarr-stack": Parser(_stack("a.zarr"), lambda path, device: read_stack(path, device=device)),
    "ply": Parser(_ply, lambda path, _: read_ply(path)),
    "mosaic": Parser(_mosaic, _lightfield(views=(2, 3), order="yvxu")),
    "grid": Parser(_grid, lambda path, _: Lattice.load(path)),
    "intrinsics": Parser(_intrinsics, lambda path, _: read_intrinsics(path)),
    "calinfo": Parser(_calinfo, lambda path, _: Lattice.load(path)),
    "parameters": Parser(_parameters, lambda path, _: read_parameters(path)),
    "positions": Parser(_positions, lambda path, _: read_positions(path, (2, 3))),
    "camera": Parser(_camera, lambda path, _: read_camera_file(path)),
    "opd": Parser(_opd, lambda path, _: read_opd_maps(path)),
    "zemax": Parser(_zemax, lambda path, _: read_zemax_opd([path], fields=[(0, 0)])),
    "volume": Parser(_volume("a.ome.tif"), lambda path, _: read_volume(path)),
    "zarr-volume": Parser(_volume("a.ome.zarr"), lambda path, _: read_volume(path)),
    "point-images": Parser(
        _point_images, lambda path, _: point_image_files.read_point_images(path)
    ),
}
