"""Which positions of a frame belong to which track: one assignment of least cost.

The cost of a link is the square of its length, a link that is not made costs the square of the
largest step (Crocker and Grier 1996, J. Colloid Interface Sci. 179, 298, section 3: the most likely
assignment of particles in random motion).
Positions that no chain of possible links joins are assigned apart, by the algorithm of Jonker and
Volgenant 1987 (`scipy.optimize.linear_sum_assignment`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Vector = np.ndarray[Any, Any]

LARGEST_GROUP = 4000  # tracks or positions that one assignment decides on


def link(expected: Vector, reach: Vector, found: Vector) -> Vector:
    """Pairs of tracks and positions."""
    if not (len(expected) and len(found)):
        return np.empty((0, 2), np.int64)
    tracks, places, costs = _candidates(expected, reach, found)
    graph = coo_array(
        (np.ones(len(tracks), np.int8), (tracks, len(expected) + places)),
        shape=(len(expected) + len(found),) * 2,
    )
    group = connected_components(graph, directed=False)[1][tracks]
    order = np.argsort(group, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
    pairs = [_assigned(tracks[part], places[part], costs[part]) for part in parts if len(part)]
    linked = np.concatenate([np.empty((0, 2), np.int64), *pairs])
    return linked[np.argsort(linked[:, 0], kind="stable")]


def _candidates(expected: Vector, reach: Vector, found: Vector) -> tuple[Vector, Vector, Vector]:
    """All links that are short enough: track, position, cost below 1."""
    near = cKDTree(found).query_ball_point(expected, reach)
    counts = np.array([len(each) for each in near])
    tracks = np.repeat(np.arange(len(expected)), counts)
    places = np.array([k for each in near for k in each], np.int64)
    off = expected[tracks] - found[places]
    return tracks, places, (off**2).sum(axis=1) / reach[tracks] ** 2


def _assigned(tracks: Vector, places: Vector, costs: Vector) -> Vector:
    """The links of one group whose sum with what stays alone is least."""
    if len(tracks) == 1:
        return np.stack([tracks, places], axis=1)
    rows, row = np.unique(tracks, return_inverse=True)
    columns, column = np.unique(places, return_inverse=True)
    if max(len(rows), len(columns)) > LARGEST_GROUP:
        raise ValueError(
            f"{max(len(rows), len(columns)):,} points lie so near to each other that any of them "
            "could be the next of any track: give a smaller step, or find fewer points."
        )
    table = np.zeros((len(rows), len(columns)))  # 0: no link, at the cost of a longest step
    table[row, column] = costs - 1.0
    chosen, to = linear_sum_assignment(table)
    linked = table[chosen, to] < 0
    return np.stack([rows[chosen[linked]], columns[to[linked]]], axis=1)
