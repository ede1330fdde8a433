"""The plan cache keeps to its bytes and drops what was used longest ago."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from types import SimpleNamespace

import numpy as np
import pytest

from clplen.compute.device import Device
from clplen.compute.fft import routes
from clplen.compute.fft.plans import PlanCache
from clplen.compute.fft.routes import FFTRoute


def put(cache: PlanCache, key: str, nbytes: int = 40) -> str:
    """The value of a key, whose bytes are stated."""
    return cache.get(key, lambda: f"plan {key}", lambda _: nbytes)


def is_kept(cache: PlanCache, key: str) -> bool:
    before = cache.misses
    cache.get(key, lambda: "made again", lambda _: cache.limit_bytes + 1)
    return cache.misses == before


def test_a_value_is_made_once() -> None:
    cache = PlanCache(100)
    assert put(cache, "a") == "plan a"
    assert cache.get("a", lambda: pytest.fail("made again"), lambda _: 0) == "plan a"
    assert (cache.hits, cache.misses, cache.nbytes, len(cache)) == (1, 1, 40, 1)


def test_none_is_a_value_too() -> None:
    cache = PlanCache(100)
    assert cache.get("a", lambda: None, lambda _: 8) is None
    assert cache.get("a", lambda: "made again", lambda _: 8) is None


def test_what_was_used_longest_ago_goes_first() -> None:
    cache = PlanCache(100)
    put(cache, "a")
    put(cache, "b")
    put(cache, "a")
    put(cache, "c")
    assert (cache.nbytes, len(cache)) == (80, 2)
    assert [is_kept(cache, key) for key in "abc"] == [True, False, True]


def test_several_go_for_a_large_one() -> None:
    cache = PlanCache(100)
    for key in "abcde":
        put(cache, key, 20)
    assert (cache.nbytes, len(cache)) == (100, 5)
    put(cache, "f", 50)
    assert (cache.nbytes, len(cache)) == (90, 3)
    assert [is_kept(cache, key) for key in "abcdef"] == [False, False, False, True, True, True]


def test_a_value_above_the_limit_is_returned_but_not_kept() -> None:
    cache = PlanCache(100)
    put(cache, "a")
    assert put(cache, "b", 101) == "plan b"
    assert (cache.nbytes, len(cache), cache.misses) == (40, 1, 2)
    assert put(cache, "c", 60) == "plan c"
    assert (cache.nbytes, len(cache)) == (100, 2)


def test_clear_drops_every_value() -> None:
    cache = PlanCache(100)
    put(cache, "a")
    cache.clear()
    assert (cache.nbytes, len(cache)) == (0, 0)
    put(cache, "a")
    assert (cache.hits, cache.misses, cache.nbytes) == (0, 2, 40)


def test_a_failure_keeps_nothing() -> None:
    cache = PlanCache(100)
    with pytest.raises(ZeroDivisionError):
        cache.get("a", lambda: 1 // 0, lambda _: 8)
    assert (cache.misses, cache.nbytes, len(cache)) == (0, 0, 0)
    assert put(cache, "a") == "plan a"


def test_two_threads_that_make_the_same_value_count_it_once() -> None:
    cache = PlanCache(100)
    both = Barrier(2, timeout=10)

    def make() -> str:
        both.wait()
        return "plan"

    with ThreadPoolExecutor(2) as pool:
        made = [pool.submit(cache.get, "a", make, lambda _: 40) for _ in range(2)]
        assert [each.result() for each in made] == ["plan", "plan"]
    assert (cache.nbytes, len(cache)) == (40, 1)


def test_threads_that_make_the_same_value_get_one() -> None:
    """As long as it is kept: of plans on a device all callers hold the same."""
    cache = PlanCache(100)
    all_three = Barrier(3, timeout=10)

    def make() -> object:
        all_three.wait()
        return object()

    with ThreadPoolExecutor(3) as pool:
        made = [pool.submit(cache.get, "a", make, lambda _: 40) for _ in range(3)]
        first, *others = [each.result() for each in made]
    assert all(other is first for other in others)
    assert cache.get("a", lambda: pytest.fail("made again"), lambda _: 0) is first
    assert (cache.nbytes, len(cache), cache.hits, cache.misses) == (40, 1, 1, 3)


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
