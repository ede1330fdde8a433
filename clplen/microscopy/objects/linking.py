"""Linking of the positions of a frame to tracks, as an assignment of minimum cost.

The cost of a link is the square of its length, the cost of a missing link is the square of the
largest step (Crocker and Grier 1996, J. Colloid Interface Sci. 179, 298, section 3: the most likely
assignment of particles in random motion). Groups of positions without possible links between them
are assigned separately, by the algorithm of Jonker and Volgenant 1987
(`scipy.optimize.linear_sum_assignment`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Vector = np.ndarray[Any, Any]

MAX_GROUP_SIZE = 4000  # tracks or positions of an assignment: its cost table has 128 MB


def link(expected: Vector, reach: Vector, positions: Vector) -> Vector:
    """Return the pairs (track, position) of minimum cost."""
    if not (len(expected) and len(positions)):
        return np.empty((0, 2), np.int64)
    tracks, targets, costs = _candidates(expected, reach, positions)
    graph = coo_array(
        (np.ones(len(tracks), np.int8), (tracks, len(expected) + targets)),
        shape=(len(expected) + len(positions),) * 2,
    )
    group = connected_components(graph, directed=False)[1][tracks]
    order = np.argsort(group, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
    pairs = [_assigned(tracks[part], targets[part], costs[part]) for part in parts if len(part)]
    linked = np.concatenate([np.empty((0, 2), np.int64), *pairs])
    return linked[np.argsort(linked[:, 0], kind="stable")]


def _candidates(
    expected: Vector, reach: Vector, positions: Vector
) -> tuple[Vector, Vector, Vector]:
    """Return all links within reach: track, position, cost below 1."""
    neighbours = cKDTree(positions).query_ball_point(expected, reach)
    counts = np.array([len(links) for links in neighbours])
    tracks = np.repeat(np.arange(len(expected)), counts)
    targets = np.array([k for links in neighbours for k in links], np.int64)
    steps = expected[tracks] - positions[targets]
    return tracks, targets, (steps**2).sum(axis=1) / reach[tracks] ** 2


def _assigned(tracks: Vector, targets: Vector, costs: Vector) -> Vector:
    """Return the links of a group with the minimum total cost, missing links included."""
    if len(tracks) == 1:
        return np.stack([tracks, targets], axis=1)
    rows, row = np.unique(tracks, return_inverse=True)
    columns, column = np.unique(targets, return_inverse=True)
    if max(len(rows), len(columns)) > MAX_GROUP_SIZE:
        raise ValueError(
            f"{max(len(rows), len(columns)):,} points are so close together that each could "
            "continue any track: give a smaller step, or find fewer points."
        )
    table = np.zeros((len(rows), len(columns)))  # 0 stands for no link, at the cost of a full step
    table[row, column] = costs - 1.0
    chosen, target = linear_sum_assignment(table)
    linked = table[chosen, target] < 0
    return np.stack([rows[chosen[linked]], columns[target[linked]]], axis=1)
