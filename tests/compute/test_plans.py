"""The plan cache keeps to its bytes and drops what was used longest ago."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from clplen import Field, Grid, propagate
from clplen.compute.device import Device
from clplen.compute.fft import routes
from clplen.compute.fft.plans import PlanCache
from clplen.compute.fft.routes import FFTRoute
from clplen.errors import DeviceError


def put(cache: PlanCache, key: str, nbytes: int = 40) -> str:
    """The value of a key, whose bytes are stated."""
    kept: str | None = cache.get(key)
    return cache.keep(key, f"plan {key}", nbytes) if kept is None else kept


def test_a_value_is_made_once() -> None:
    cache = PlanCache(100)
    assert put(cache, "a") == "plan a"
    assert cache.get("a") == "plan a"
    assert (cache.hits, cache.misses, cache.nbytes, len(cache)) == (1, 1, 40, 1)


def test_what_was_used_longest_ago_goes_first() -> None:
    cache = PlanCache(100)
    put(cache, "a")
    put(cache, "b")
    put(cache, "a")
    put(cache, "c")
    assert (cache.nbytes, len(cache)) == (80, 2)
    assert [cache.get(key) for key in "abc"] == ["plan a", None, "plan c"]
    put(cache, "d", 90)  # for which several go
    assert (cache.nbytes, len(cache)) == (90, 1)


def test_a_value_above_the_limit_is_returned_but_not_kept() -> None:
    cache = PlanCache(100)
    put(cache, "a")
    assert put(cache, "b", 101) == "plan b"
    assert (cache.nbytes, len(cache), cache.misses) == (40, 1, 2)
    assert put(cache, "c", 60) == "plan c"
    assert (cache.nbytes, len(cache)) == (100, 2)


def test_callers_that_make_the_same_value_get_one() -> None:
    """As long as it is kept: of plans on a device all callers hold the same."""
    cache = PlanCache(100)
    first, *others = [cache.keep("a", object(), 40) for _ in range(3)]
    assert all(other is first for other in others)
    assert cache.get("a") is first
    assert (cache.nbytes, len(cache), cache.hits, cache.misses) == (40, 1, 1, 3)


def test_caches_beside_each_other_keep_to_one_limit() -> None:
    one = PlanCache(100)
    other = PlanCache(100, one)
    put(one, "a")
    put(other, "a")
    assert (len(one), len(other), one.shared_bytes) == (1, 1, 80)
    put(one, "a")
    put(other, "b")  # the other's "a" was used longest ago
    assert (one.nbytes, other.nbytes, other.shared_bytes) == (40, 40, 80)
    assert (one.get("a"), other.get("a"), other.get("b")) == ("plan a", None, "plan b")
    one.clear()
    assert (len(one), one.nbytes, len(other), other.shared_bytes) == (0, 0, 1, 40)


def kept_bytes(one: Device) -> int:
    """Bytes that a device keeps for later calls."""
    pools = [each._spare for each in one._precisions if "_spare" in each.__dict__]
    spare = sum(pool.managed_bytes - pool.active_bytes for pool in pools)
    return one.plans.shared_bytes + spare + one.workspace.nbytes


def test_a_sweep_keeps_to_one_limit_in_both_precisions(
    device: Device, precise: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLPLEN_SPARE_MEMORY", "12 MiB")
    single = Device(device.cl_device)
    double = Device(precise.cl_device, precision="double", sibling=single)
    double.fft = single.fft = FFTRoute("scipy", 2)
    assert (single.spare_bytes, double.spare_bytes) == (12 << 20, 12 << 20)
    for n in range(12):
        for one in (single, double):
            u = np.ones((170 + n, 190), one.complex)
            grid = Grid(u.shape, 5e-6)
            field = Field.from_array(u, grid, wavelength=5e-7, device=one)
            propagate(field, 0.005, method="as")
            del field
            one.empty((2**20 + n * 2**18,), np.float32)
            one.empty((8,), np.float32)  # what was let go is counted now
            assert kept_bytes(one) <= 12 << 20
    assert len(single.plans) > 0  # neither drives out the other
    assert len(double.plans) > 0
    double.free_spare()
    assert (len(single.plans), len(double.plans), kept_bytes(single)) == (0, 0, 0)


def test_the_default_is_a_gibibyte_on_a_cpu(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CLPLEN_SPARE_MEMORY", raising=False)
    if device.is_cpu:
        assert Device(device.cl_device).spare_bytes == min(2**30, device.memory_bytes // 4)
    monkeypatch.setenv("CLPLEN_SPARE_MEMORY", "much")
    with pytest.raises(DeviceError, match=r"CLPLEN_SPARE_MEMORY must be .* got 'much'"):
        Device(device.cl_device)


def test_plans_of_vkfft_count_in_bytes(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """A megabyte each for kernels and tables, and the buffer that some lengths need."""
    one = Device(device.cl_device)
    transforms = dict.fromkeys(("fft", "ifft"), lambda *_, **__: None)
    for extra, shape in ((0, (4, 4)), (1000, (4, 5))):
        app = SimpleNamespace(tmp_buffer_nbytes=extra, **transforms)
        monkeypatch.setattr(routes, "_vkfft_app", lambda *_, app=app: app)
        FFTRoute("vkfft", 1).forward(one.upload(np.zeros(shape, np.complex64)), one)
    assert one.transforms.nbytes == 2 * 2**20 + 1000
    assert one.plans.nbytes == 0
