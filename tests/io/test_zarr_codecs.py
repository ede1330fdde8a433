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


def filtered(path: Path, name: str = "lightfield") -> None:
    change(path / name / ".zarray", lambda found: found.update(filters=[V2]))


def in_filters(path: Path) -> None:
    filtered(stored(path, 2))


def in_compressor(path: Path) -> None:
    change(stored(path, 2) / "lightfield" / ".zarray", lambda found: found.update(compressor=V2))


def in_a_nested_array(path: Path) -> None:
    filtered(stored(path, 2), "labels/0")


def in_codecs(path: Path) -> None:
    file = stored(path, 3) / "lightfield" / "zarr.json"
    change(file, lambda found: found["codecs"].append(V3))


def in_weights_of_format_3(path: Path) -> None:
    file = stored(path, 3) / "weights" / "zarr.json"
    change(file, lambda found: found["codecs"].append({"name": "numcodecs.pickle"}))


def sharded(path: Path) -> Path:
    return stored(path, 3, chunks=(1, 1, 5, 4), shards=(1, 3, 5, 4)) / "lightfield" / "zarr.json"


def in_a_shard(path: Path) -> None:
    change(sharded(path), lambda found: found["codecs"][0]["configuration"]["codecs"].append(V3))


def in_the_index_of_a_shard(path: Path) -> None:
    def put(found: dict[str, Any]) -> None:
        found["codecs"][0]["configuration"]["index_codecs"].append(V3)

    change(sharded(path), put)


def in_consolidated_metadata(path: Path) -> None:
    zarr.consolidate_metadata(str(stored(path, 2)))
    change(
        path / ".zmetadata",
        lambda found: found["metadata"]["lightfield/.zarray"].update(filters=[V2]),
    )


def in_consolidated_metadata_of_format_3(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the package: not part of the specification
        zarr.consolidate_metadata(str(stored(path, 3)))

    def put(found: dict[str, Any]) -> None:
        found["consolidated_metadata"]["metadata"]["lightfield"]["codecs"].append(V3)

    change(path / "zarr.json", put)


def in_the_other_format_beside(path: Path) -> None:
    stored(path, 3)
    stored(path.with_name("other"), 2)
    filtered(path.with_name("other"))
    for name in (".zgroup", "lightfield/.zarray"):
        shutil.copy(path.with_name("other") / name, path / name)


def in_objects(path: Path) -> None:
    change(
        stored(path, 2) / "weights" / ".zarray",
        lambda found: found.update(dtype="|O", filters=[{"id": "vlen-utf8"}, {"id": "pickle"}]),
    )


def in_a_structure_with_objects(path: Path) -> None:
    kind = [["a", "<f4"], ["b", [["c", "|O"]]]]
    change(stored(path, 2) / "labels/0" / ".zarray", lambda found: found.update(dtype=kind))


def in_texts_of_format_3(path: Path) -> None:
    file = stored(path, 3) / "labels/0" / "zarr.json"
    change(file, lambda found: found.update(data_type="string", codecs=[{"name": "vlen-utf8"}]))


def in_the_type_of_a_filter(path: Path) -> None:
    delta = {"id": "delta", "dtype": "|O", "astype": "|O"}
    file = stored(path, 2) / "lightfield" / ".zarray"
    change(file, lambda found: found.update(filters=[delta]))


def in_a_single_array(path: Path) -> None:
    shutil.move(stored(path.with_name("g"), 2) / "lightfield", path)
    change(path / ".zarray", lambda found: found.update(filters=[V2]))


PLACES = [
    in_filters,
    in_compressor,
    in_a_nested_array,
    in_codecs,
    in_weights_of_format_3,
    in_a_shard,
    in_the_index_of_a_shard,
    in_consolidated_metadata,
    in_consolidated_metadata_of_format_3,
    in_the_other_format_beside,
    in_objects,
    in_a_structure_with_objects,
    in_texts_of_format_3,
    in_the_type_of_a_filter,
    in_a_single_array,
]
SAID = r"(packed by the codec '[\w.-]+', which is not accepted|data type .*, which is not accepted)"


def test_refused_and_not_run(tmp_path: Path, one_device: Device, sung: Path):
    for plant in PLACES:
        path = tmp_path / plant.__name__ / "a.zarr"
        plant(path)
        if plant in (in_filters, in_codecs):
            path = Path(shutil.make_archive(str(path.with_name("a")), "zip", path))
        with pytest.raises(FormatError, match=rf"a\.z.*{SAID}"):
            read_lightfield(path, device=one_device)
        with (
            pytest.raises(FormatError, match=rf"a\.z.*{SAID}"),
            open_lightfield(path, device=one_device),
        ):
            pass
        assert not sung.exists(), plant


@pytest.mark.parametrize("plant", [in_filters, in_a_shard], ids=lambda p: p.__name__)
def test_the_canary_sings_where_nobody_looks(
    tmp_path: Path, sung: Path, plant: Callable[[Path], None]
):
    plant(tmp_path / "a.zarr")
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
    with pytest.raises(FileExistsError, match="no OME-Zarr"):
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
    filters = [
        [numcodecs.Delta(dtype="u1")],
        [numcodecs.FixedScaleOffset(offset=0, scale=1, dtype="u1", astype="u2")],
        [numcodecs.Shuffle(1), numcodecs.CRC32()],
    ]
    for number, chain in enumerate(filters):
        array = zarr.create_array(
            str(tmp_path / f"{number}.zarr"),
            shape=SHAPE,
            dtype="u1",
            zarr_format=2,
            filters=chain,
            compressors=numcodecs.Zstd(),
        )
        array[...] = values()
        lf = read_lightfield(tmp_path / f"{number}.zarr", device=one_device)
        np.testing.assert_array_equal(lf.to_numpy(), values())
