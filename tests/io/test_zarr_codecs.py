"""Zarr stores whose metadata name codecs that run code: refused, and nothing is run."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import open_lightfield, read_disparity, read_lightfield, write_image
from clplen.io.results.volume_files import is_volume, read_volume, write_volume

zarr = pytest.importorskip("zarr")
numcodecs = pytest.importorskip("numcodecs")
codecs = pytest.importorskip("zarr.codecs")
Codec = pytest.importorskip("numcodecs.abc").Codec
BytesBytesCodec = pytest.importorskip("zarr.abc.codec").BytesBytesCodec

SHAPE = (2, 3, 5, 4)
V2 = {"id": "canary"}
V3 = {"name": "canary"}


@pytest.fixture
def sung(tmp_path: Path) -> Iterator[Path]:
    """A file that appears when one of the codecs ``canary``, ``pickle`` or ``vlen-utf8`` runs."""
    file = tmp_path / "canary"

    class Canary(Codec):
        codec_id = "canary"

        def encode(self, buf: Any) -> Any:
            return buf

        def decode(self, buf: Any, out: Any = None) -> Any:
            file.write_text("sung")
            return buf

    class Canary3(BytesBytesCodec):
        is_fixed_size = True

        @classmethod
        def from_dict(cls, data: Any) -> Canary3:
            return cls()

        def to_dict(self) -> dict[str, Any]:
            return dict(V3)

        def compute_encoded_size(self, input_byte_length: int, _: Any) -> int:
            return input_byte_length

        async def _decode_single(self, chunk_data: Any, chunk_spec: Any) -> Any:
            file.write_text("sung")
            return chunk_data

        async def _encode_single(self, chunk_data: Any, chunk_spec: Any) -> Any:
            return chunk_data

    known = dict(numcodecs.registry.codec_registry)
    for name in ("canary", "pickle", "vlen-utf8"):
        numcodecs.register_codec(Canary, name)
    for name in ("canary", "numcodecs.pickle"):
        zarr.registry.register_codec(name, Canary3)
    yield file
    numcodecs.registry.codec_registry.clear()
    numcodecs.registry.codec_registry.update(known)


def values() -> np.ndarray:
    return np.arange(120, dtype=np.uint8).reshape(SHAPE)


def stored(path: Path, form: int, **words: Any) -> Path:
    """A store with ``lightfield``, ``weights``, ``positions`` and ``labels/0``, not compressed."""
    group = zarr.open_group(str(path), mode="w", zarr_format=form)
    arrays = {
        "lightfield": values(),
        "weights": np.ones((2, 3), np.float32),
        "positions": np.ones((2, 3, 2)),
        "labels/0": values(),
    }
    for name, array in arrays.items():
        more = words if name == "lightfield" else {}
        made = group.create_array(
            name, shape=array.shape, dtype=array.dtype, compressors=None, **more
        )
        made[...] = array
    return path


def change(file: Path, act: Callable[[dict[str, Any]], Any]) -> None:
    document = json.loads(file.read_text())
    act(document)
    file.write_text(json.dumps(document))


def filtered(path: Path, name: str = "lightfield", **words: Any) -> None:
    """Change the metadata of an array of format 2, by default its filters."""
    change(path / name / ".zarray", lambda found: found.update(words or {"filters": [V2]}))


def coded(path: Path, codec: dict[str, Any], name: str = "lightfield") -> None:
    """One codec more for an array of format 3."""
    change(path / name / "zarr.json", lambda found: found["codecs"].append(codec))


def in_shards(path: Path, place: str) -> None:
    """One codec more for the chunks of a shard, or for its index."""
    file = stored(path, 3, chunks=(1, 1, 5, 4), shards=(1, 3, 5, 4)) / "lightfield" / "zarr.json"
    change(file, lambda found: found["codecs"][0]["configuration"][place].append(V3))


def consolidated(path: Path, form: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the package: format 3 does not specify it
        zarr.consolidate_metadata(str(stored(path, form)))

    def put(found: dict[str, Any]) -> None:
        if form == 2:
            found["metadata"]["lightfield/.zarray"].update(filters=[V2])
        else:
            found["consolidated_metadata"]["metadata"]["lightfield"]["codecs"].append(V3)

    change(path / {2: ".zmetadata", 3: "zarr.json"}[form], put)


def both_formats(path: Path) -> None:
    stored(path, 3)
    other = stored(path.with_name("other"), 2)
    filtered(other)
    for name in (".zgroup", "lightfield/.zarray"):
        shutil.copy(other / name, path / name)


def texts_of_format_3(path: Path) -> None:
    file = stored(path, 3) / "labels/0" / "zarr.json"
    change(file, lambda found: found.update(data_type="string"))


OBJECTS = {"dtype": "|O", "filters": [{"id": "vlen-utf8"}, {"id": "pickle"}]}
DELTA = {"id": "delta", "dtype": "|O", "astype": "|O"}
PLACES: dict[str, Callable[[Path], None]] = {
    "filters": lambda path: filtered(stored(path, 2)),
    "compressor of a nested array": lambda p: filtered(stored(p, 2), "labels/0", compressor=V2),
    "codecs": lambda path: coded(stored(path, 3), V3),
    "weights of format 3": lambda p: coded(stored(p, 3), {"name": "numcodecs.pickle"}, "weights"),
    "shard": lambda path: in_shards(path, "codecs"),
    "index of a shard": lambda path: in_shards(path, "index_codecs"),
    "consolidated": lambda path: consolidated(path, 2),
    "consolidated, format 3": lambda path: consolidated(path, 3),
    "other format beside": both_formats,
    "texts of format 3": texts_of_format_3,
    "objects": lambda path: filtered(stored(path, 2), "weights", **OBJECTS),
    "structure with objects": lambda p: filtered(stored(p, 2), dtype=[["b", [["c", "|O"]]]]),
    "type of a filter": lambda path: filtered(stored(path, 2), filters=[DELTA]),
}
SAID = r"(packed with the codec '[\w.-]+'|data type .*), which is not accepted"


def test_refused_and_not_run(tmp_path: Path, one_device: Device, sung: Path):
    for name, plant in PLACES.items():
        path = tmp_path / name / "a.zarr"
        plant(path)
        if name in ("filters", "codecs"):
            path = Path(shutil.make_archive(str(path.with_name("a")), "zip", path))
        with pytest.raises(FormatError, match=rf"a\.z.*{SAID}"):
            read_lightfield(path, device=one_device)
        with (
            pytest.raises(FormatError, match=rf"a\.z.*{SAID}"),
            open_lightfield(path, device=one_device),
        ):
            pass
        assert not sung.exists(), name


@pytest.mark.parametrize("name", ["filters", "shard"])
def test_the_canary_sings_where_nobody_looks(tmp_path: Path, sung: Path, name: str):
    PLACES[name](tmp_path / "a.zarr")
    np.testing.assert_array_equal(zarr.open(str(tmp_path / "a.zarr"))["lightfield"][...], values())
    assert sung.exists()


def test_volumes_and_depth_maps(tmp_path: Path, sung: Path):
    cube = np.ones((2, 4, 5), np.float32)
    path = tmp_path / "v.ome.zarr"
    write_volume(path, cube, planes=[0, 1e-6], voxel=(1e-6, 1e-6))
    assert is_volume(path)
    np.testing.assert_array_equal(read_volume(path)[0], cube)
    np.testing.assert_array_equal(read_disparity(path), cube[0])
    filtered(path, "0")
    for read in (read_volume, read_disparity):
        with pytest.raises(FormatError, match="codec 'canary', which is not accepted"):
            read(path)
    assert not is_volume(path)
    with pytest.raises(FileExistsError, match="not an OME-Zarr"):
        write_image(path, cube[0])
    assert not sung.exists()


COMPRESSORS = [
    (2, numcodecs.Blosc()),
    (2, numcodecs.Zstd()),
    (2, numcodecs.LZ4()),
    (2, numcodecs.GZip()),
    (2, numcodecs.Zlib()),
    (2, numcodecs.BZ2()),
    (2, numcodecs.LZMA()),
    (3, codecs.BloscCodec(typesize=1)),
    (3, codecs.ZstdCodec()),
    (3, codecs.GzipCodec()),
]


def test_compressors_are_accepted(tmp_path_factory: pytest.TempPathFactory, one_device: Device):
    for form, codec in COMPRESSORS:
        tmp_path = tmp_path_factory.mktemp("case")
        array = zarr.create_array(
            str(tmp_path / "a.zarr"), shape=SHAPE, dtype="u1", zarr_format=form, compressors=codec
        )
        array[...] = values()
        lf = read_lightfield(tmp_path / "a.zarr", device=one_device)
        np.testing.assert_array_equal(lf.to_numpy(), values())


def test_filters_are_accepted(tmp_path: Path, one_device: Device):
    for number, chain in enumerate([
        [numcodecs.Delta(dtype="u1")],
        [numcodecs.FixedScaleOffset(offset=0, scale=1, dtype="u1", astype="u2")],
        [numcodecs.Shuffle(1), numcodecs.CRC32()],
    ]):  # fmt: skip
        path = tmp_path / f"{number}.zarr"
        array = zarr.create_array(
            str(path), shape=SHAPE, dtype="u1", zarr_format=2, filters=chain,
            compressors=numcodecs.Zstd(),
        )  # fmt: skip
        array[...] = values()
        np.testing.assert_array_equal(read_lightfield(path, device=one_device).to_numpy(), values())
