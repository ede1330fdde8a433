"""Plans: tiles that cover the picture once, within the budget, with their halos."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.refocusing.focal_stacks import MemoryEstimate
from clplen.lightfield.streaming import tile_plan
from clplen.lightfield.streaming.tile_plan import plan_tiles


def source(shape=(3, 4, 211, 307), chunks=None, views_at_once=(1, 1), overhead=0):
    """A light field that nobody reads."""

    def fill(block, out):
        raise AssertionError("read")

    return StoredLightField(
        shape,
        np.dtype(np.uint8),
        fill,
        np.ones(shape[:2], np.float32),
        chunks or (1, shape[3]),
        views_at_once,
        overhead,
    )


def work(halo=(7, 11), per_pixel=100, largest=20, result_bytes=0, passes=1, planes=1):
    groups = tuple(slice(i, i + 1) for i in range(planes))
    return MemoryEstimate("A test", groups, halo, per_pixel, largest, result_bytes, passes=passes)


def covered(plan, size):
    """How often every pixel is written; halos are checked on the way."""
    count = np.zeros(size, int)
    for tile in plan.tiles:
        count[tile.rows, tile.columns] += 1
        pairs = (
            (tile.rows, tile.outer_rows, size[0], plan.halo[0]),
            (tile.columns, tile.outer_columns, size[1], plan.halo[1]),
        )
        for inner, outer, n, halo in pairs:
            assert 0 <= outer.start <= max(inner.start - halo, 0)
            assert min(inner.stop + halo, n) <= outer.stop <= n
            assert inner.start < inner.stop
    return count


@pytest.mark.parametrize("halo", [(0, 0), (7, 11), (1, 40), (90, 3), (300, 300)])
def test_every_pixel_is_written_once(device, halo):
    lf = source()
    for memory in (23_000, 60_000, 400_000, 3_000_000):
        try:
            plan = plan_tiles(lf, [work(halo=halo)], memory=memory, device=device)
        except ValueError as error:
            least = int(str(error).split("needs ")[1].split(";")[0].replace(",", ""))
            assert least > memory
            plan = plan_tiles(lf, [work(halo=halo)], memory=least, device=device)
            memory = least
        assert (covered(plan, (211, 307)) == 1).all()
        assert plan.bytes_peak <= memory


def test_the_least_memory_is_nearly_the_least(device):
    with pytest.raises(ValueError, match=r"memory=1,000 bytes.*needs [\d,]+; pass that") as info:
        plan_tiles(source(), [work()], memory=1000, device=device)
    least = int(str(info.value).split("needs ")[1].split(";")[0].replace(",", ""))
    assert plan_tiles(source(), [work()], memory=least, device=device).tiles
    with pytest.raises(ValueError, match="does not fit"):
        plan_tiles(source(), [work()], memory=int(0.98 * least), device=device)


def test_bands_unless_parts_of_rows_read_less(device):
    def total(plan):
        return sum(np.prod(tile.outer_shape) for tile in plan.tiles)

    # a band of 16 rows with its halo of 7 needs 30 x 307 x (2 x 12 + 100) bytes and a reserve
    least = 30 * 307 * 124 * 16 / 15
    low = plan_tiles(source(), [work()], memory=int(least * 1.01), device=device)
    assert len({tile.columns.start for tile in low.tiles}) > 1
    assert all(tile.outer_columns.start % 16 == 0 for tile in low.tiles)
    bands = -(-(211 - 14) // 16)
    assert total(low) < bands * 30 * 307 / 1.15
    high = plan_tiles(source(), [work()], memory=int(least * 4), device=device)
    assert len(high.tiles) == 2
    assert all(tile.columns == slice(0, 307) for tile in high.tiles)


def test_everything_in_one_tile(device):
    copies = 1 if device.is_cpu else 2
    need = 211 * 307 * (12 * copies + 100 + 3) + 50
    lf = source(overhead=50)
    plan = plan_tiles(
        lf, [work(result_bytes=3, passes=2)], memory=need * 16 // 15 + 16, device=device
    )
    assert plan.in_core
    assert plan.bytes_peak == need
    assert plan.passes == 1
    assert plan.bytes_read == lf.nbytes
    assert "all in core" in str(plan)
    short = plan_tiles(lf, [work(result_bytes=3, passes=2)], memory=need, device=device)
    assert not short.in_core
    assert short.passes == 2


def test_bytes_read(device):
    lf = source()
    plan = plan_tiles(lf, [work(passes=2)], memory=1_300_000, device=device)
    area = sum(a * b for a, b in (tile.outer_shape for tile in plan.tiles))
    assert plan.bytes_read == 2 * 12 * area
    assert plan.bytes_scratch == 0
    chunked = source(chunks=(16, 307))
    same = plan_tiles(chunked, [work()], memory=1_300_000, device=device)
    assert 12 * area < same.bytes_read <= 12 * (area + 2 * 16 * 307 * len(plan.tiles))


def test_a_copy_of_views_that_are_unpacked_as_a_whole(device):
    lf = source(chunks=(211, 307), overhead=1000)
    plan = plan_tiles(lf, [work()], memory=1_300_000, device=device)
    assert plan.bytes_scratch == plan.bytes_read == lf.nbytes
    assert "copied to a temporary file" in str(plan)
    two = plan_tiles(lf, [work(halo=(0, 0))], memory=5_200_000, device=device)
    assert len(two.tiles) == 2
    assert two.bytes_scratch == 0
    with pytest.raises(ValueError, match="does not fit"):  # one row of views does not
        plan_tiles(
            source(chunks=(211, 307), views_at_once=(1, 4)),
            [work(per_pixel=1, largest=1)],
            memory=200_000,
            device=device,
        )


def test_fewer_planes_only_where_all_do_not_fit(device):
    works = [work(planes=1), work(per_pixel=50, planes=2)]
    assert len(plan_tiles(source(), works, memory=1_000_000, device=device).planes) == 1
    small = work(halo=(0, 0), per_pixel=100), work(halo=(0, 0), per_pixel=10, planes=2)
    assert len(plan_tiles(source(), small, memory=22_000, device=device).planes) == 2


def test_a_pass_before_reads_full_rows(device):
    two = MemoryEstimate(
        "A test", (slice(0, 1),), (7, 11), 100, 20, result_bytes=3, before=40, passes=2
    )
    plan = plan_tiles(source(), [two], memory=3_400_000, device=device)
    room = 3_400_000 * 15 // 16 - 40 * 211 * 307
    assert plan.band_rows == room // (2 * 12 * 307)
    assert 0 < plan.band_rows < 211
    with pytest.raises(ValueError, match="does not fit"):  # the tiles alone would
        plan_tiles(source(), [two], memory=2_700_000, device=device)


def test_memory_is_a_number_of_bytes(device):
    for memory in (0, -5, 1.5, True):
        with pytest.raises(ValueError, match="positive number of bytes"):
            plan_tiles(source(), [work()], memory=memory, device=device)


def test_default_memory_is_half_of_what_is_free(device, monkeypatch):
    monkeypatch.setattr(tile_plan, "free_memory", lambda: 2_000_000)
    assert plan_tiles(source(), [work()], memory=None, device=device).memory == 1_000_000
