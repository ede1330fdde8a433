"""The kernel that measures arithmetic computes what it says."""

from __future__ import annotations

import numpy as np

from clplen.compute.device import Device


def test_sums_of_products(device: Device) -> None:
    for lanes, counted in [(1, 1), (4, 2), (16, 2)]:
        chains, rounds, m = 3, 5, 0.75
        few = np.random.default_rng(3).random(8).astype(np.float32)
        kernel = device.kernel("ceiling.cl", "multiply_add", LANES=lanes, CHAINS=chains)
        out = device.empty((70,), np.float32)
        numbers = (np.int32(7), np.int32(rounds), np.float32(m))
        device.launch(kernel, (70,), out, device.upload(few), *numbers, group=(1,))

        i = np.arange(70)
        expected = np.zeros(70)
        for j in range(chains):
            s = few[(i + j) & 7].astype(np.float64)
            for r in range(rounds):
                s = s * m + few[(i + r) & 7]
            expected += counted * s
        # one rounding of 6e-8 a multiply-add and a sum
        np.testing.assert_allclose(device.download(out), expected, rtol=(rounds + chains) * 1.2e-7)
