"""How much of the fall of brightness over a picture goes on within its lenslets.

A filter, a lamp or a relay darkens the sensor's pixels, so that lenslets are brighter on one side;
an objective that vignettes darkens every lenslet as a whole. The means of the lenslets do not tell
the two apart, but a slope that is taken off and is not there moves all centres outwards.

Of equal lenslets of the profile f(r), r from the centre, whose fall exp(g r) was taken off too
much by the share 1 - s, and whose centres are off by d, linear in the place, the picture is

    f(r) - (1 - s) (g r) f(r) - d grad f(r)

to first order. s and the six numbers of d follow by least squares: d shows at the rims of lenslets,
s all over them. Of a Gaussian profile grad f is r f up to a factor, and s cannot be told.
"""

from __future__ import annotations

import numpy as np

from clplen.lightfield.arrays.reciprocal import Values
from clplen.lightfield.calibration.equalisation import Even

_PIXELS = 150_000  # at random, that are enough
_WIDTH = 0.5  # px: standard deviation of the smoothing of the profile
_SMALL = 6.0  # px: smaller lenslets have too few pixels to tell
_OWN = 0.15  # of the fall's energy that no shift of the centres explains: less tells nothing


def fall_share(even: Even, margin: int) -> float:
    """The share s of the fall that goes on within lenslets, 0 to 1.

    Parameters
    ----------
    even : Even
        With the whole fall taken off (``share=1``), by a lattice that fits to a part of a pixel.
    margin : int
        Pixels along the border that are left out.

    Returns
    -------
    float
        1 where it cannot be told.
    """
    if np.hypot(*even.lenslets.cell.T).min() < _SMALL:
        return 1.0
    at, value = _sample(even.picture, margin)
    label, core = even.lenslets.nearest(*at)
    at, value, centre = at[:, core], value[core], even.lenslets.centres(label[core]).T
    away = at - centre
    profile, slopes = _profile(away, value, even.lenslets.cell)
    fall = profile * (even.fall.slopes(centre) * away).sum(axis=0)
    half = (np.array(even.picture.shape)[:, None] - 1) / 2
    place = np.stack([np.ones(len(value)), *(centre / half - 1)])
    shifts: Values = (slopes[:, None] * place).reshape(6, -1)
    only = fall - _fitted(shifts, fall)
    if not only @ only > _OWN * (fall @ fall):
        return 1.0
    return float(np.clip(1 + only @ (value - profile) / (only @ only), 0, 1))


def _sample(picture: Values, margin: int) -> tuple[Values, Values]:
    """Places (2, n) and values of all pixels, of many ones chosen at random, always the same."""
    whole = picture[margin : picture.shape[0] - margin, margin : picture.shape[1] - margin]
    chosen = np.arange(whole.size)
    if whole.size > _PIXELS:
        chosen = np.random.default_rng(0).integers(0, whole.size, _PIXELS)
    at = np.stack(np.divmod(chosen, whole.shape[1])) + margin
    return at, picture[at[0], at[1]].astype(np.float64)


def _profile(away: Values, value: Values, cell: Values) -> tuple[Values, Values]:
    """The mean lenslet f at places (2, n) from the centre, and its gradient (2, n), smoothed."""
    from scipy.ndimage import gaussian_filter

    pitch = float(np.hypot(*cell.T).max())
    n = int(np.clip(round(3 * pitch), 24, 96))
    inverse = np.linalg.inv(cell)
    index = np.rint(n * (inverse.T @ away)).astype(int) % n
    where = index[0] * n + index[1]
    count = np.bincount(where, minlength=n * n)
    total = np.bincount(where, value, n * n)
    soft = [
        gaussian_filter(a.reshape(n, n).astype(float), _WIDTH * n / pitch, mode="wrap")
        for a in (total, count)
    ]
    table = soft[0] / np.maximum(soft[1], 1e-9)
    table = (table + np.roll(table[::-1, ::-1], (1, 1), (0, 1))) / 2  # lenslets are symmetric
    steps = [(np.roll(table, -1, axis) - np.roll(table, 1, axis)) * n / 2 for axis in (0, 1)]
    slopes = inverse @ np.stack([step.ravel()[where] for step in steps])
    return table.ravel()[where], slopes


def _fitted(rows: Values, value: Values) -> Values:
    """The sum of rows that is nearest to values."""
    return np.asarray(np.linalg.pinv(rows @ rows.T, hermitian=True) @ (rows @ value) @ rows)
