"""Microlens array: sampling rule, messages, centres."""

import numpy as np
import pytest
import reference

from clplen import Field, Grid, MicrolensArray, SamplingError

LAM = 532e-9


def ones(grid, device):
    return Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)


def test_lenslets_below_two_samples(device):
    grid = Grid((16, 16), 5e-6)
    with pytest.raises(SamplingError, match=r"at least 2 samples, got 9.5e-06 m"):
        MicrolensArray(9.5e-6, 1e-3, count=3).apply(ones(grid, device))


def test_the_diameter_counts_for_aliasing(device):
    """Gaps between lenslets need no sampling: R is half the diameter, not half the pitch."""
    grid = Grid((64, 64), 5e-6)
    f = 2 * 60e-6 * 5e-6 / LAM  # R_max = 60 um
    MicrolensArray(150e-6, f, count=2, diameter=119e-6).apply(ones(grid, device))
    with pytest.raises(SamplingError, match="R_max"):
        MicrolensArray(150e-6, f, count=2, diameter=121e-6).apply(ones(grid, device))


def test_bad_arrays():
    for change, message in [
        ({"pitch": 0}, "pitch of lenslets must be positive"),
        ({"f": 0}, "focal length of lenslets"),
        ({"count": 0}, "count of lenslets"),
        ({"count": (3, 2.5)}, "count of lenslets"),
        ({"lattice": "cubic"}, "lattice must be 'square' or 'hexagonal'"),
        ({"fill": "round"}, "fill must be 'circular' or 'full'"),
        ({"diameter": 2e-4}, "between 0 and its pitch"),
        ({"count": (3, 3, 3)}, "one number or"),
        ({"rotation": np.nan}, "all finite"),
        ({"f": ()}, "focal length of lenslets must be finite"),
        ({"f": (1e-2, 0)}, "focal length of lenslets must be finite"),
        ({"f": (1e-2, 2e-2, 1e-2)}, "multi-focus array differ"),
        ({"f": (1e-2, 2e-2), "lattice": "hexagonal"}, "one or three kinds of lenslets, got 2"),
        ({"offset": (np.nan, 0)}, "all finite"),
    ]:
        values = {"pitch": 1e-4, "f": 1e-2, "count": 3} | change
        pitch, f = values.pop("pitch"), values.pop("f")
        with pytest.raises(ValueError, match=message):
            MicrolensArray(pitch, f, **values)


def test_centres_turn_x_towards_y():
    array = MicrolensArray(0.1, 1.0, count=(1, 3), rotation=np.pi / 2, offset=(0.2, 0.4))
    np.testing.assert_allclose(array.centres()[0], [(0.1, 0.4), (0.2, 0.4), (0.3, 0.4)], atol=1e-13)
    twin = reference.lenslet_centres(0.1, count=(3, 4), lattice="hexagonal", rotation=0.3)
    ours = MicrolensArray(0.1, 1.0, count=(3, 4), lattice="hexagonal", rotation=0.3).centres()
    np.testing.assert_allclose(ours[..., ::-1], twin, atol=1e-13)


def test_neighbours_differ_in_focal_length_and_kinds_are_as_many():
    for lattice, kinds in [
        ("square", 2),
        ("square", 3),
        ("square", 4),
        ("square", 5),
        ("hexagonal", 3),
    ]:
        lengths = tuple(1e-2 * (1 + n) for n in range(kinds))
        array = MicrolensArray(0.1, lengths, count=(20, 20), lattice=lattice)
        assert (array.f, array.focal_lengths) == (1e-2, lengths)
        kind, place = array.types().ravel(), 10 * array.centres().reshape(-1, 2)
        apart = np.hypot(*(place[:, None] - place[None]).transpose(2, 0, 1))
        near = (apart > 0) & (apart < 1.01)
        assert (kind[:, None] != kind[None])[near].all()
        alike = apart[(kind[:, None] == kind[None]) & (apart > 0)].min()
        assert alike > {2: 1.4, 3: 1.4, 4: 1.9, 5: 2.2}[kinds] * (
            1.2 if lattice == "hexagonal" else 1
        )
        assert np.ptp(np.bincount(kind)) <= 0.1 * 400 / kinds
        # a type's own lattice: the same steps lead from any of its lenslets to others of it
        mine = place[kind == 1]
        middle = mine[np.hypot(*(mine - place.mean(0)).T).argmin()]
        steps = mine[np.hypot(*(mine - middle).T) < 4] - middle
        for start in mine[np.abs(mine - place.mean(0)).max(1) < 4]:
            reached = np.hypot(*(mine[None] - (start + steps)[:, None]).transpose(2, 0, 1)).min(1)
            assert reached.max() < 1e-9


def test_one_focal_length_in_a_sequence_is_one():
    assert MicrolensArray(1e-4, [1e-2], count=3) == MicrolensArray(1e-4, 1e-2, count=3)


def test_the_shortest_focal_length_counts_for_aliasing(device):
    grid = Grid((64, 64), 5e-6)
    fine = 2 * 75e-6 * 5e-6 / LAM * 1.01
    MicrolensArray(150e-6, (fine, 2 * fine), count=2).apply(ones(grid, device))
    with pytest.raises(SamplingError, match="R_max"):
        MicrolensArray(150e-6, (2 * fine, 0.9 * fine), count=2).apply(ones(grid, device))


# Other words ------------------------------------------------------------------------------------


def test_square_lenslets_of_a_square_lattice_fill_it():
    assert MicrolensArray(1e-4, 1e-2, count=3, fill="square").fill == "full"
    with pytest.raises(ValueError, match="fill must be 'circular' or 'full'"):
        MicrolensArray(1e-4, 1e-2, count=3, fill="square", lattice="hexagonal")
