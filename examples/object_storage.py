"""A focal stack from one store of objects to another, tile by tile, through fsspec.

    python examples/object_storage.py [SOURCE] [--target URL] [--memory BYTES] [--device pocl]

URLs are fsspec's: s3://bucket/field.zarr, gs://..., file:///..., memory://... SOURCE is a Zarr
array (v, u, y, x[, c]); without one, a sample is put into memory first. Neither it nor the stack
is ever held as a whole. Needs: pip install "clplen[batch]".
"""

import argparse
from typing import Any

import fsspec
import numpy as np
import zarr

from clplen import Device, StoredLightField
from clplen.cameras import sample_scenes
from clplen.lightfield import stack_tiles

SAMPLE = "memory://sample.zarr"


def created(url: str, shape: tuple[int, ...], chunks: tuple[int, ...]) -> Any:
    """A new Zarr array of float32 behind a URL, in format 2, which every reader knows."""
    fsspec.core.url_to_fs(url)[0].makedirs(url, exist_ok=True)
    form = {} if zarr.__version__.startswith("2.") else {"zarr_format": 2}
    store = fsspec.get_mapper(url)
    return zarr.create(shape=shape, chunks=chunks, dtype="f4", store=store, **form)


def put_sample(device: Device) -> None:
    """Bars before a wall, a chunk a row of views."""
    scene = next(one for one in sample_scenes(1, (96, 120)) if one.name == "bars").scene
    lf, _ = scene.light_field((7, 9), (96, 120), device=device)
    created(SAMPLE, lf.shape, (1, *lf.shape[1:]))[...] = lf.to_numpy()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("source", nargs="?")
    parser.add_argument("--target", default="memory://stack.zarr")
    parser.add_argument("--memory", type=int, default=16 << 20)
    parser.add_argument("--device")
    given = parser.parse_args()
    device = Device.open(given.device)
    if given.source is None:
        put_sample(device)
    stored = StoredLightField.from_array(
        zarr.open_array(fsspec.get_mapper(given.source or SAMPLE), mode="r")
    )
    planes = np.linspace(-2, 2, 17)
    tiles = stack_tiles(stored, disparities=planes, memory=given.memory, device=device)
    stack = created(given.target, tiles.shape, (1, *tiles.shape[1:]))
    stack.attrs["disparities"] = planes.tolist()
    for where in tiles:
        stack[where[:3]] = where[3]
    print(f"{stored}\n{tiles.plan}\n{given.target} holds {tiles.shape}.")


if __name__ == "__main__":
    main()
