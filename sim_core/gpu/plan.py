"""Lists after which a thread block adds up what elements leave, laid out once a mesh (include/plan.hpp)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

SIZES = ("unknowns", "row_nodes", "blocks", "tiles", "panel_tiles", "reach")
ARRAYS = (
    ("own", np.int32), ("number", np.int32),
    ("triangle_start", np.int32), ("triangle_at", np.int32), ("hinge_start", np.int32), ("hinge_at", np.int32),
    ("sample_start", np.int32), ("sample_at", np.int32), ("sample_weight", np.float64), ("sample_contact", np.int32),
    ("row_start", np.int32), ("row_coupling", np.int32), ("row_corner", np.int32), ("block_node", np.int32),
    ("mass_start", np.int32), ("mass_at", np.int32),
    ("bend_start", np.int32), ("bend_corner", np.int32), ("bend_place", np.int32),
    ("part_start", np.int32), ("part_at", np.int32),
    ("contact_start", np.int32), ("contact_at", np.int32), ("contact_weight", np.float64),
    ("border_start", np.int32), ("border_at", np.int32),
    ("last", np.int32), ("first", np.int32), ("panel_start", np.int32),
    ("entry_start", np.int32), ("entry", np.int32), ("diagonal", np.int32),
)  # fmt: skip
"""Fields of ``Plan``, in its order."""

TILE, BLOCK_ENTRIES = 8, 9
PAIR = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Places of pairs of corners among those with the first one first."""


class _Pairs:
    """What adds to blocks of pairs of nodes (later, earlier), found before the blocks are."""

    def __init__(self, rank: np.ndarray, idle: np.ndarray) -> None:
        self._rank, self._idle = rank, idle
        self._found: dict[str, tuple[np.ndarray, tuple[np.ndarray, ...]]] = {}

    def add(self, name: str, row: np.ndarray, column: np.ndarray, *what: np.ndarray) -> None:
        keep = (self._rank[row] >= self._rank[column]) & ~(self._idle[row] & self._idle[column])
        key = row[keep].astype(np.int64) * len(self._rank) + column[keep]
        self._found[name] = key, tuple(w[keep] for w in what)

    def blocks(self) -> np.ndarray:
        """Nodes of all blocks ``(b, 2)``, those with most to add up first: threads of a warp have as much to do."""
        keys, work = np.unique(np.concatenate([key for key, _ in self._found.values()]), return_counts=True)
        pairs = np.stack(np.divmod(keys, len(self._rank)), axis=-1)
        order = np.argsort(-work, kind="stable")
        self._keys, self._place = keys, np.argsort(order)
        found: np.ndarray = pairs[order]
        return found

    def lists(self, name: str) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Starts by blocks, and what adds to them."""
        key, what = self._found[name]
        at = self._place[np.searchsorted(self._keys, key)]
        order = np.argsort(at, kind="stable")
        return _starts(at, len(self._keys)), tuple(w[order] for w in what)


def _starts(groups: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(np.bincount(groups, minlength=count))])


def _by_node(nodes: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts by nodes, and which entries of ``nodes`` they are."""
    return _starts(nodes, count), np.argsort(nodes, kind="stable")


def plan_of(record: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of the plan, for a record of sheets with contact of rigid shapes (:mod:`sim_core.core.record`)."""
    count = int(record["nodes"])
    rank, prescribed = np.asarray(record["rank"]), np.asarray(record["prescribed"]).reshape(-1, 3) != 0
    triangle, hinge = (np.asarray(record[n], dtype=np.int64) for n in ("triangle", "hinge"))
    samples = np.asarray(record["sample_node"], dtype=np.int64).reshape(-1, int(record["corners"]))
    weights = np.asarray(record["sample_weight"], dtype=float).reshape(samples.shape)
    order = np.argsort(rank)
    components = (3 * order[:, None] + np.arange(3)).ravel()
    own = components[~prescribed.ravel()[components]]
    number = np.full(3 * count, -1)
    number[own] = np.arange(len(own))

    pairs = _Pairs(rank, prescribed.all(axis=1))
    starts, columns = np.asarray(record["mass_start"]), np.asarray(record["mass_column"], dtype=np.int64)
    pairs.add("mass", np.repeat(np.arange(count), np.diff(starts)), columns, np.arange(len(columns)))
    t, a, d = np.meshgrid(np.arange(len(triangle)), np.arange(3), np.arange(3), indexing="ij")
    pairs.add("stretch", triangle[t, a].ravel(), triangle[t, d].ravel(), (2 * (6 * t + PAIR[a, d]) + (a > d)).ravel())
    of_row, row_node, rows = _rows(record, hinge)
    e, corner = np.repeat(of_row, 4), np.tile(np.arange(4), len(of_row))
    pairs.add("bend", hinge[e, corner], np.repeat(row_node, 4), 4 * e + corner, np.repeat(np.arange(len(of_row)), 4))
    e, side, i, j = np.meshgrid(np.arange(len(hinge)), np.arange(2), np.arange(3), np.arange(3), indexing="ij")
    corners = [hinge[e, np.where(k < 2, k, 2 + side)].ravel() for k in (i, j)]
    pairs.add("side", *corners, (2 * (6 * (len(triangle) + 2 * e + side) + PAIR[i, j]) + (i > j)).ravel())
    s, a, d = np.meshgrid(np.arange(len(samples)), *2 * [np.arange(samples.shape[1])], indexing="ij")
    shares = (weights[s, a] * weights[s, d]).ravel()
    s, a, d = (k.ravel()[shares != 0.0] for k in (s, a, d))
    pairs.add("contact", samples[s, a], samples[s, d], s, shares[shares != 0.0])

    blocks = pairs.blocks()
    found: dict[str, Any] = {"own": own, "number": number, **rows}
    for name, fields in (("mass", ("at",)), ("bend", ("corner", "place")), ("contact", ("at", "weight"))):
        found[f"{name}_start"], what = pairs.lists(name)
        found.update({f"{name}_{field}": w for field, w in zip(fields, what, strict=True)})
    (stretch, (stretched,)), (side, (turned,)) = pairs.lists("stretch"), pairs.lists("side")
    found["part_start"] = np.append(np.stack([stretch[:-1] + side[:-1], stretch[1:] + side[:-1]], axis=-1).ravel(),
                                    stretch[-1] + side[-1])  # fmt: skip
    ends = np.concatenate([np.repeat(side[1:] - np.diff(side), np.diff(stretch)),
                           np.repeat(stretch[1:], np.diff(side))])  # fmt: skip
    parts = np.empty(len(stretched) + len(turned), dtype=np.int64)
    parts[np.concatenate([np.arange(len(stretched)), np.arange(len(turned))]) + ends] = np.concatenate(
        [stretched, turned]
    )
    found["part_at"] = parts
    found["triangle_start"], found["triangle_at"] = _by_node(triangle.ravel(), count)
    found["hinge_start"], found["hinge_at"] = _by_node(hinge.ravel(), count)
    counts = np.flatnonzero(weights.ravel())
    found["sample_start"], at = _by_node(samples.ravel()[counts], count)
    found["sample_at"], found["sample_weight"] = counts[at] // samples.shape[1], weights.ravel()[counts[at]]
    found["sample_contact"] = np.repeat(np.arange(int(record["contacts"])), np.diff(record["sample_start"]))
    found |= _border(blocks, prescribed) | _factor(blocks, number, len(own))
    return found | {"blocks": len(blocks), "block_node": blocks, "unknowns": len(own)}


def _rows(record: Mapping[str, Any], hinge: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Hinges and nodes of the rows of bending's Hessian, and what adds to them."""
    start, column = np.asarray(record["coupling_start"]), np.asarray(record["coupling_column"], dtype=np.int64)
    of = np.repeat(np.arange(len(hinge)), np.diff(start))
    size = int(hinge.max(initial=0)) + 1
    keys, place = np.unique(of[:, None] * size + hinge[column], return_inverse=True)
    starts, at = _by_node(place.ravel(), len(keys))
    corners = (4 * column[:, None] + np.arange(4)).ravel()
    lists = {"row_nodes": len(keys), "row_start": starts, "row_coupling": at // 4, "row_corner": corners[at]}
    return keys // size, keys % size, lists


def _border(blocks: np.ndarray, prescribed: np.ndarray) -> dict[str, np.ndarray]:
    """By nodes, blocks through which the motion of prescribed components acts on them."""
    held = np.asarray(prescribed).any(axis=1).reshape(-1)
    direct = np.flatnonzero(held[blocks[:, 1]])
    turned = np.flatnonzero(held[blocks[:, 0]] & (blocks[:, 0] != blocks[:, 1]))
    nodes = np.concatenate([blocks[direct, 0], blocks[turned, 1]])
    start, at = _by_node(nodes, len(prescribed))
    return {"border_start": start, "border_at": np.concatenate([2 * direct, 2 * turned + 1])[at]}


def _factor(blocks: np.ndarray, number: np.ndarray, unknowns: int) -> dict[str, Any]:
    """Places of the entries of the blocks in tiles, and the envelope of these."""
    tiles = -(-unknowns // TILE)
    block, p, q = np.meshgrid(np.arange(len(blocks)), np.arange(3), np.arange(3), indexing="ij")
    row, column = number[3 * blocks[block, 0] + p].ravel(), number[3 * blocks[block, 1] + q].ravel()
    value = (9 * block + 3 * p + q).ravel()
    keep = (row >= 0) & (column >= 0) & (column <= row)
    row, column, value = row[keep], column[keep], value[keep]
    diagonal = np.empty(unknowns, dtype=np.int64)
    diagonal[row[row == column]] = value[row == column]
    last = np.arange(tiles)
    np.maximum.at(last, column // TILE, row // TILE)
    last = np.maximum.accumulate(last)
    first = np.searchsorted(last, np.arange(tiles))
    widths = TILE * TILE * (np.arange(tiles) - first + 1)
    starts = np.concatenate([[0], np.cumsum(widths)])
    entry = np.full(starts[-1], BLOCK_ENTRIES * len(blocks))
    tile = starts[row // TILE] + TILE * TILE * (column // TILE - first[row // TILE])
    entry[tile + TILE * (row % TILE) + column % TILE] = value
    beyond = np.arange(unknowns - TILE * (tiles - 1), TILE)  # rows that fill the last tile
    entry[starts[-1] - TILE * TILE + (TILE + 1) * beyond] += 1
    panel = np.concatenate([[0], np.cumsum(last - np.arange(tiles) + 1)])
    return {
        "tiles": tiles,
        "panel_tiles": int(panel[-1]),
        "reach": int((last - np.arange(tiles)).max(initial=0)) + 1,
        "last": last,
        "first": first,
        "panel_start": panel,
        "entry_start": starts // (TILE * TILE),
        "entry": entry,
        "diagonal": diagonal,
    }
