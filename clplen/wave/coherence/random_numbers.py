"""Counter-based random numbers: the same on every device, in any order, for any snapshot."""

from __future__ import annotations

from typing import Any

import numpy as np

Words = np.ndarray[Any, np.dtype[np.uint32]]

ROUNDS = 10
_MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL = np.uint32(0x9E3779B9), np.uint32(0xBB67AE85)
LARGEST_SEED = 2**64 - 1
LARGEST_INDEX = 2**32 - 1


def philox(counters: Any, key: Any) -> Words:
    """Philox4x32-10: four random words for each counter (Salmon et al. 2011, section 3.3).

    Parameters
    ----------
    counters : array_like of uint32
        Shape (..., 4).
    key : array_like of uint32
        Shape (2,).

    Returns
    -------
    numpy.ndarray of uint32
        Shape (..., 4).
    """
    words = [np.asarray(counters, np.uint32)[..., i] for i in range(4)]
    keys = np.asarray(key, np.uint32).copy()
    with np.errstate(over="ignore"):
        for _ in range(ROUNDS):
            high0, low0 = _product(_MULTIPLIERS[0], words[0])
            high1, low1 = _product(_MULTIPLIERS[1], words[2])
            words = [high1 ^ words[1] ^ keys[0], low1, high0 ^ words[3] ^ keys[1], low0]
            keys += _WEYL
    return np.stack(words, axis=-1)


def key_of(seed: int) -> Words:
    """The key of a seed: its lower and its upper 32 bits.

    Raises
    ------
    ValueError
        If the seed is no whole number from 0 to 2^64 - 1.
    """
    check_seed(seed)
    return np.array([seed & 0xFFFFFFFF, int(seed) >> 32], np.uint32)


def check_seed(seed: int) -> None:
    """Refuse what is no whole number from 0 to 2^64 - 1.

    Raises
    ------
    ValueError
    """
    whole = isinstance(seed, (int, np.integer)) and not isinstance(seed, bool)
    if not (whole and 0 <= seed <= LARGEST_SEED):
        raise ValueError(f"A seed is a whole number from 0 to 2^64 - 1, not {seed!r}.")


def uniform(seed: int, index: int, stream: int, count: int) -> np.ndarray[Any, Any]:
    """Four independent uniform numbers for each of ``count`` counters.

    Parameters
    ----------
    seed : int
        0 to 2^64 - 1.
    index : int
        Of the snapshot, 0 to 2^32 - 1.
    stream : int
        Numbers of different streams are independent; 0 is that of the cells of masks.
    count : int

    Returns
    -------
    numpy.ndarray
        float64 in [0, 1), multiples of 2^-32, shape (count, 4).
    """
    counters = np.zeros((count, 4), np.uint32)
    counters[:, 0] = np.arange(count)
    counters[:, 2], counters[:, 3] = index, stream
    return philox(counters, key_of(seed)) * 2.0**-32


def _product(multiplier: np.uint64, word: Words) -> tuple[Words, Words]:
    """Upper and lower 32 bits of a product."""
    product = multiplier * word.astype(np.uint64)
    return (product >> np.uint64(32)).astype(np.uint32), product.astype(np.uint32)
