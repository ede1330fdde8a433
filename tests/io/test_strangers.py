"""Files from strangers: nothing in them is executed, and none leads to another file."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import stat
import threading
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import (
    open_lightfield,
    open_volumes,
    read_disparity,
    read_frame,
    read_intrinsics,
    read_lattice,
    read_lightfield,
    read_opd_maps,
    read_picture,
    read_raw,
    read_raytrix,
    read_scene_truth,
    read_stack,
    read_truth,
    write_lightfield,
    write_picture,
)
from clplen.io.formats.tiff import read_tiff_frame
from clplen.io.results.focused_files import describe_focused
from clplen.io.results.volume_files import is_volume, read_volume
from clplen.io.store.picture_series import describe_series
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy.model import point_image_files

SHAPE = (2, 3, 5, 4)


class Canary:
    """Its pickle writes a file when it is read."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.write_text, (self.file, "sung"))


def values() -> np.ndarray:
    return np.arange(120, dtype=np.uint8).reshape(SHAPE)


def refused(message: str, read: Callable[..., Any], *args: Any, **words: Any) -> None:
    with pytest.raises(FormatError, match=message):
        read(*args, **words)


def opened(path: Path, **words: Any) -> None:
    with open_lightfield(path, **words):
        pass


# NumPy


def test_pickles(tmp_path: Path, one_device: Device):
    sung, file = tmp_path / "canary", tmp_path / "a.npy"
    array = np.empty(SHAPE, object)
    array[...] = Canary(sung)
    np.save(file, array, allow_pickle=True)
    for read in (read_lightfield, read_disparity, read_volume):
        refused(r"a\.npy", read, file)
    assert not sung.exists()
    np.load(file, allow_pickle=True)
    assert sung.exists()
    sung.unlink()
    for name in ("a.npy", "a.mat", "a.h5", "a.png"):
        (tmp_path / name).write_bytes(pickle.dumps(Canary(sung)))
        refused(name, read_lightfield, tmp_path / name, device=one_device)
        refused(name, read_disparity, tmp_path / name)
    assert not sung.exists()


# HDF5


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file of the user that lies elsewhere."""
    (tmp_path / "elsewhere").mkdir()
    with h5py.File(tmp_path / "elsewhere" / "secret.h5", "w") as file:
        file["lightfield"] = values()
        file["weights"] = np.ones((2, 3))
        file["disparity"] = np.ones((5, 4), np.float32)
        file["masks/near"] = np.ones((5, 4), np.uint8)
        file["group/LF"] = values()
        file["planes/0000"] = np.ones((1, 3, 3), np.float32)
    return tmp_path / "elsewhere" / "secret.h5"


def linked(file: h5py.File, name: str, secret: Path) -> None:
    file[name] = h5py.ExternalLink(str(secret), name)


def by_two_links(file: h5py.File, _: str, secret: Path) -> None:
    file["hidden"] = h5py.ExternalLink(str(secret), "/group")
    file["LF"] = h5py.SoftLink("/hidden/LF")


def external(file: h5py.File, name: str, secret: Path) -> None:
    words = {"external": [(str(secret), 0, 120)], "dtype": "u1", "shape": SHAPE}
    file.create_dataset(name, **words)


def virtual(file: h5py.File, name: str, secret: Path) -> None:
    layout = h5py.VirtualLayout(SHAPE, "u1")
    layout[...] = h5py.VirtualSource(str(secret), "lightfield", SHAPE)
    file.create_virtual_dataset(name, layout)


WAYS = [linked, by_two_links, external, virtual]
SAID = r"a\.h5: .*(is a link to another file|stored in other files).*copy"


def test_hdf5_that_leads_to_other_files(tmp_path: Path, one_device: Device, secret: Path):
    path = tmp_path / "a.h5"
    for way, name in [*((way, "lightfield") for way in WAYS), (linked, "weights")]:
        with h5py.File(path, "w") as file:
            if name == "weights":
                file["lightfield"] = values()
            way(file, name, secret)
        refused(SAID, read_lightfield, path, device=one_device)
        refused(SAID, opened, path, device=one_device)


def test_other_readers_of_hdf5(tmp_path: Path, secret: Path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name in ("disparity", "masks", "raw", "planes", "scales"):
            linked(file, name, secret)
        file["lenslets/m"] = np.ones(2)
        file.attrs["format"] = point_image_files.FORMAT
    for read in (
        read_truth,
        read_scene_truth,
        read_disparity,
        read_raw,
        point_image_files.read_point_images,
    ):
        refused(SAID, read, path)
    assert point_image_files.read_parameters(path) is None
    assert describe_focused(path) is None


def test_a_soft_link_inside_is_followed(tmp_path: Path, one_device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["data/samples"] = values()
        file["lightfield"] = h5py.SoftLink("/data/samples")
    lf = read_lightfield(tmp_path / "a.h5", device=one_device)
    np.testing.assert_array_equal(lf.to_numpy(), values())


def test_hdf5_holds_no_objects(tmp_path: Path, one_device: Device):
    """h5py takes the tag of an opaque type for a type of NumPy."""
    for kind in ["objects", "references", "texts"]:
        with h5py.File(tmp_path / "a.h5", "w") as file:
            if kind == "objects":
                opaque = h5py.h5t.create(h5py.h5t.OPAQUE, 8)
                opaque.set_tag(b"NUMPY:|O")
                space = h5py.h5s.create_simple(SHAPE)
                h5py.h5d.create(file.id, b"lightfield", opaque, space)
                h5py.h5a.create(file.id, b"dH", opaque, h5py.h5s.create_simple((1,)))
            else:
                dtype = h5py.ref_dtype if kind == "references" else h5py.string_dtype()
                file.create_dataset("lightfield", SHAPE, dtype)
        refused(r"a\.h5", read_lightfield, tmp_path / "a.h5", device=one_device)
        refused(r"a\.h5", read_truth, tmp_path / "a.h5", dataset="lightfield")


def test_point_images_that_declare_more_than_they_hold(tmp_path: Path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs.update({"format": point_image_files.FORMAT, "parameters": "{}", "digest": ""})
        file.create_dataset("planes/0000", (10**4, 10**3, 10**3), "f4", chunks=(1, 10**3, 10**3))
        file["scales"] = np.ones(1)
    refused("not a complete file", point_image_files.read_point_images, tmp_path / "a.h5")


# XML and TIFF


def test_entities_in_xml(tmp_path: Path):
    secret = tmp_path / "secret"
    secret.write_text("0.5")
    external = f'<!DOCTYPE a [<!ENTITY x SYSTEM "file://{secret}">]>'
    for head in (external, '<!DOCTYPE a [<!ENTITY x "1">]>', "<!DOCTYPE a>"):
        (tmp_path / "a.xml").write_text(f"{head}<RayCalibData>&x;</RayCalibData>")
        refused("declares a document type or entities", read_raytrix, tmp_path / "a.xml")
        text = f"{head}<OME><Description>&x;</Description></OME>"
        tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 5), "f4"), description=text)
        assert describe_series(tmp_path / "a.tif") == {}


def test_ome_xml_that_names_other_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Only pages of the file itself are read; no other one is opened."""
    opened: list[str] = []
    usual = tifffile.TiffFile.__init__

    def noted(self: Any, file: Any, *words: Any, **more: Any) -> None:
        opened.append(str(file))
        usual(self, file, *words, **more)

    monkeypatch.setattr(tifffile.TiffFile, "__init__", noted)
    for companion in [True, False]:
        name = "b.ome.tif"
        tifffile.imwrite(tmp_path / name, np.full((2, 6, 7), 9, "f4"), metadata={"axes": "ZYX"})
        planes = "".join(
            f'<TiffData FirstZ="{z}" IFD="0"><UUID FileName="{name}">urn:uuid:{z}</UUID></TiffData>'
            for z in range(2)
        )
        text = (
            '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:9">'
            + companion * f'<BinaryOnly MetadataFile="{name}" UUID="urn:uuid:0"/>'
            + '<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="float" '
            f'SizeX="7" SizeY="6" SizeZ="2" SizeC="1" SizeT="1">{planes}</Pixels></Image></OME>'
        )
        path = tmp_path / "a.ome.tif"
        tifffile.imwrite(path, np.full((6, 7), 3, "f4"), description=text, metadata=None)
        opened.clear()
        assert (read_disparity(path) == 3).all()
        assert (read_tiff_frame(path) == 3).all()
        assert (read_picture(path) == 3).all()
        assert (read_volume(path)[0] == 3).all()
        assert describe_focused(path) is None
        assert not [file for file in opened if name in file]


# Pictures


def test_pictures_of_other_kinds(tmp_path: Path):
    """Pillow would hand PostScript to another program."""
    for name, content in (("a.png", b"%!PS-Adobe-3.0 EPSF-3.0\n(x) run\n"), ("a.tif", b"GIF89a")):
        (tmp_path / name).write_bytes(content)
        refused("is not PNG, TIFF, JPEG", read_picture, tmp_path / name)


# Zip archives and folders


def test_links_in_an_archive_are_not_followed(tmp_path: Path, one_device: Device):
    write_picture(tmp_path / "secret.tif", values()[0, 0])
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name in ("view_00_00.tif", "view_00_01.tif"):
            link = zipfile.ZipInfo(name)
            link.external_attr = (stat.S_IFLNK | 0o777) << 16
            archive.writestr(link, str(tmp_path / "secret.tif"))
    refused("unreadable", read_lightfield, tmp_path / "a.zip", device=one_device)


def test_links_out_of_a_zarr(tmp_path: Path, one_device: Device):
    pytest.importorskip("zarr")
    for number, place in enumerate(("lightfield/0.0.0.0", "lightfield", "a pipe")):
        path, other = (tmp_path / f"{number}{name}" / "a.zarr" for name in ("", "other"))
        for one in (path, other):
            one.parent.mkdir()
            write_lightfield(one, LightField.from_array(values(), device=one_device))
        if place == "a pipe":
            os.mkfifo(path / "lightfield" / ".zattrs2")
            refused("neither a file nor a folder", read_lightfield, path, device=one_device)
            return
        target = path / place
        shutil.rmtree(target) if target.is_dir() else target.unlink()
        target.symlink_to(other / place)
        refused("a link to a file outside", read_lightfield, path, device=one_device)


def test_names_that_look_like_addresses(tmp_path: Path, one_device: Device):
    pytest.importorskip("zarr")
    lf = LightField.from_array(values(), device=one_device)
    for name in ["simplecache::c.zarr", "memory:"]:
        write_lightfield(tmp_path / "lf.zarr", lf)
        (tmp_path / "lf.zarr").rename(tmp_path / name)
        again = read_lightfield(tmp_path / name, device=one_device)
        np.testing.assert_array_equal(again.to_numpy(), values())
    write_lightfield(tmp_path / "new:simplecache::c.zarr", lf)


def test_paths_in_the_metadata_of_a_zarr(tmp_path: Path, one_device: Device):
    """The path of a data set in OME-Zarr is not followed out of it."""
    zarr = pytest.importorskip("zarr")
    from clplen.io import write_image

    write_image(tmp_path / "a.zarr", np.ones((4, 5), np.float32))
    write_image(tmp_path / "b.zarr", np.ones((6, 7), np.float32))
    file = tmp_path / "a.zarr" / ".zattrs"
    document = json.loads(file.read_text())
    document["multiscales"][0]["datasets"][0]["path"] = "../b.zarr/0"
    file.write_text(json.dumps(document))
    assert zarr.open(str(tmp_path / "a.zarr"), mode="r")["0"].shape == (4, 5)
    with pytest.raises(FileExistsError, match="exists already and is not an OME-Zarr"):
        write_image(tmp_path / "a.zarr", np.ones((6, 7), np.float32))


# MATLAB, pipes


def test_objects_of_matlab(tmp_path: Path, one_device: Device):
    cell = np.empty((2, 2), object)
    cell[...] = "system('true')"
    scipy.io.savemat(tmp_path / "a.mat", {"LF": cell, "s": {"f": cell}})
    refused("has no variable", read_lightfield, tmp_path / "a.mat", device=one_device)


def test_a_frame_of_many_needs_no_more_memory_than_it_has(tmp_path: Path) -> None:
    """Of a long series only the page that is asked for is read."""
    path = tmp_path / "series.tif"
    frames = np.arange(40, dtype=np.uint16)[:, None, None] + np.zeros((24, 32), np.uint16)
    tifffile.imwrite(path, frames, photometric="minisblack")
    few = 2 * frames[0].nbytes
    assert path.stat().st_size > 10 * few
    for number in (0, 39):
        values = read_tiff_frame(path, frame=number, max_bytes=few)
        assert np.array_equal(values, frames[number])
    with pytest.raises(FormatError, match="more than 1,535"):
        read_tiff_frame(path, frame=0, max_bytes=frames[0].nbytes - 1)


@contextmanager
def pipe_at(path: Path) -> Iterator[Path]:
    """A pipe whose writer ends as soon as it is read, so that a test fails and does not wait."""
    os.mkfifo(path)
    writer = threading.Thread(target=lambda: os.close(os.open(path, os.O_WRONLY)), daemon=True)
    writer.start()
    yield path
    end = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    writer.join(10)
    os.close(end)
    path.unlink()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are of POSIX")
def test_pipes_are_not_waited_for(tmp_path: Path):
    said = r"pipe\S* (is not a file|is neither a file|must be a file)"
    for read, suffix in [
        (read_lightfield, ".h5"),
        (read_opd_maps, ".h5"),
        (read_intrinsics, ".json"),
        (lambda path: read_lattice(path, (32, 32)), ".json"),
        (read_stack, ".tif"),
        (open_volumes, ".zarr"),
    ]:
        with pipe_at(tmp_path / f"pipe{suffix}") as path:
            refused(said, read, path)
    with pipe_at(tmp_path / "pipe") as path:
        assert not is_volume(path)
        assert describe_series(path) == {}


def test_json_that_is_too_deep_or_too_long(tmp_path: Path):
    for text in ["[" * 100_000, '{"a":' * 100_000, "1" * 5000, '{"views": 1e999}']:
        path = tmp_path / "a.json"
        path.write_text(text)
        for read in (read_intrinsics, Lattice.load, read_frame):
            with pytest.raises(FormatError, match=r"a\.json"):
                read(path)
