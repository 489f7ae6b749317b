"""Kanerva coding, compiled, exactly: float32 leaves out what is surely too far, float64 decides what is close.

`columns` (signals + 1, K + room for lists) holds the prototypes' coordinates in float32, a signal a row, and below
them their distances from the present state; `places` says which prototype a column is. From column K on come the
neighbour lists, one for each set: the prototypes that were nearest to a state, its anchor. A list answers for
another state as long as the distance of the farthest chosen and the way from the anchor together stay within its
reach, the distance of the farthest listed (as in molecular dynamics; Verlet 1967).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtagent.kernels.compiling import kernel
from rtagent.kernels.masks import WIDTH, lowest_bit, within_limit
from rtagent.kernels.normalise import READ_ONLY, to_unit_cube
from rtagent.kernels.prototypes import Doubles, Singles, distance, length, measure, slack

Places = NDArray[np.int64]

METRIC, SETS, LAYERS, ROOM, PROXIMITY, BOUNDS = range(6)
"""Where things stand in `plan`; after the bounds of the sets come, for each, the counts of its layers, falling."""
LISTED, REACH, GAP, LIST_LIMIT, ANCHOR = range(5)
"""Where things stand in each row of `memory`; after the anchor come the last limits of the layers."""


class Store(NamedTuple):
    """What a coder keeps between two states."""

    rows: Doubles
    columns: Singles
    places: Places
    plan: Places
    memory: Doubles


@kernel()
def _count(distances: Singles, limit: float) -> int:
    single, count = np.float32(limit), np.int32(0)
    for k in range(len(distances)):
        count = np.int32(count + np.int32(distances[k] <= single))
    return int(count)


@kernel()
def _limit(
    distances: Singles, least: int, most: int, guess: float, signals: int, tolerance: float
) -> tuple[float, float]:
    """Return a limit, twice, within which lie from `least` to `most` of the distances.

    Where they lie too close, return two between which their number passes from below `least` to over `most`. The
    search steps from `guess` by what the numbers at hand are wrong, then along the chord of those on both sides.
    """
    low, high, below, above, limit = -1.0, signals + 1.0, 0, len(distances), float(np.float32(guess))
    wanted = 0.5 * (least + most) + 0.25
    spacing = 2.0 * guess / (signals * wanted)
    for attempt in range(200):
        count = _count(distances, limit)
        if least <= count <= most:
            return limit, limit
        if count < least:
            low, below = limit, count
        else:
            high, above = limit, count
        if high - low <= tolerance:
            break
        if attempt % 3 == 2 and below > 0 and above < len(distances):
            limit = 0.5 * (low + high)
        elif below > 0 and above < len(distances):
            limit = low + (high - low) * (wanted - below) / (above - below)
        else:
            limit += (wanted - count) * spacing * 2.0**attempt
        limit = float(np.float32(limit if low < limit < high else 0.5 * (low + high)))
        if not low < limit < high:
            break
    return low, high


@kernel()
def _keep(distances: Singles, places: Places, limit: float, offset: int, kept: Places) -> int:
    """Write the places of what is within the limit, in their order; return how many."""
    single, count, whole = np.float32(limit), np.uint64(0), len(distances) - len(distances) % WIDTH
    for start in range(0, whole, WIDTH):
        near = within_limit(distances, start, single)
        while near:
            kept[count] = places[np.uint64(start + lowest_bit(near))] + offset
            count += np.uint64(1)
            near &= near - np.uint64(1)
    for k in range(whole, len(distances)):
        if distances[k] <= single:
            kept[count] = places[k] + offset
            count += np.uint64(1)
    return int(count)


@kernel()
def _exactly(
    distances: Singles, places: Places, rows: Doubles, point: Doubles, metric: int, low: float, high: float
) -> Doubles:
    """Return in float64 the distances that were measured as from `low` to `high`, in their order."""
    exact, count = np.empty(len(distances)), 0
    for k in range(len(distances)):
        if low <= distances[k] <= high:
            exact[count] = distance(rows[places[k]], point, metric)
            count += 1
    return exact[:count]


@kernel()
def _decide(
    distances: Singles,
    places: Places,
    close: Doubles,
    count: int,
    low: float,
    high: float,
    offset: int,
    kept: Places,
) -> None:
    """Write the places of the `count` nearest: all below `low`, none above `high`, in between those by `close`."""
    wanted = count
    for k in range(len(distances)):
        wanted -= distances[k] < low
    threshold = np.partition(close, wanted - 1)[wanted - 1] if wanted > 0 else -1.0
    ties = wanted - np.sum(close < threshold)
    written = asked = 0
    for k in range(len(distances)):
        taken = distances[k] < low
        if low <= distances[k] <= high:
            tied = close[asked] == threshold and ties > 0
            taken = close[asked] < threshold or tied
            ties -= tied
            asked += 1
        if taken:
            kept[written] = places[k] + offset
            written += 1


@kernel()
def _choose(
    distances: Singles, places: Places, rows: Doubles, point: Doubles, metric: int,
    count: int, guess: float, offset: int, kept: Places,
) -> float:  # fmt: skip
    """Write the places of the `count` nearest, ties to the lower; return a distance that none of them exceeds."""
    signals = len(point)
    low, high = _limit(distances, count, count, guess, signals, slack(guess, signals, metric))
    unsure = slack(high, signals, metric)
    if low == high and _count(distances, low - unsure) == _count(distances, high + unsure) == count:
        _keep(distances, places, high, offset, kept)
    else:
        low, high = low - 2.0 * unsure, high + 2.0 * unsure
        close = _exactly(distances, places, rows, point, metric, low, high)
        _decide(distances, places, close, count, low, high, offset, kept)
    return high + unsure


@kernel()
def _weigh(
    near: Places, rows: Doubles, point: Doubles, metric: int, offset: int, chosen: Places, values: Doubles
) -> None:
    """Write all of `near` but the farthest (of those the last), and by how much each is nearer than that one."""
    distances, last, total, written = np.empty(len(near)), 0, 0.0, 0
    for k in range(len(near)):
        distances[k] = distance(rows[near[k]], point, metric)
        last = k if distances[k] >= distances[last] else last
    farther = length(distances[last], metric)
    for k in range(len(near)):
        if k != last:
            chosen[written] = near[k] + offset
            values[written] = 1.0 - length(distances[k], metric) / farther if farther > 0.0 else 0.0
            total += values[written]
            written += 1
    for k in range(written):
        values[k] = values[k] * (written / total) if total > 0.0 else 1.0


@kernel()
def _select(
    first: int, last: int, reach: float, group: int, point: Doubles, chosen: Places, values: Doubles, store: Store
) -> bool:
    """Write the features of a set from these columns; return whether all that could be nearer is among them."""
    plan, rows, start = store.plan, store.rows, 0
    metric, layers = plan[METRIC], plan[LAYERS]
    counts = plan[BOUNDS + plan[SETS] + 1 + group * layers :]
    limits = store.memory[group, ANCHOR + len(point) :]
    distances, places = store.columns[len(point), first:last], store.places[first:last]
    for layer in range(layers):
        end, offset, guess = start + counts[layer], layer * len(rows), limits[layer]
        if plan[PROXIMITY]:
            near = np.empty(counts[layer] + 1, np.int64)
            limit = _choose(distances, places, rows, point, metric, len(near), guess, 0, near)
            _weigh(near, rows, point, metric, offset, chosen[start:end], values[start:end])
        else:
            limit = _choose(distances, places, rows, point, metric, counts[layer], guess, offset, chosen[start:end])
        if length(limit, metric) > reach:
            return False
        limits[layer], start = limit, end
    return True


@kernel()
def _list(group: int, lasting: bool, point: Doubles, store: Store) -> int:
    """Measure a whole set and list its nearest; return how many, 0 where too many are equally near.

    Only a list that is to be `lasting`, for other states too, is long and has coordinates.
    """
    plan, columns, own, signals = store.plan, store.columns, store.memory[group], len(point)
    start, end, first = plan[BOUNDS + group], plan[BOUNDS + group + 1], len(store.rows) + group * plan[ROOM]
    count = plan[BOUNDS + plan[SETS] + 1 + group * plan[LAYERS]] + plan[PROXIMITY]
    least, most = (5 * count // 2, 7 * count // 2) if lasting else (9 * count // 8 + 1, 13 * count // 8 + 2)
    measure(columns, start, end, point, plan[METRIC])
    guess = own[LIST_LIMIT] if lasting else own[ANCHOR + signals]
    low, high = _limit(columns[signals, start:end], least, most, guess, signals, 0.0)
    own[ANCHOR : ANCHOR + signals], own[LISTED] = point, 0.0
    if low != high:
        return 0
    listed = _keep(columns[signals, start:end], store.places[start:end], high, 0, store.places[first:])
    for k in range(first, first + listed):
        columns[signals, k] = columns[signals, store.places[k]]
    own[REACH] = length(high - slack(high, signals, plan[METRIC]), plan[METRIC])
    if lasting:
        own[LISTED], own[LIST_LIMIT] = listed, high
        for k in range(first, first + listed):
            for signal in range(signals):
                columns[signal, k] = store.rows[store.places[k], signal]
    return listed


@kernel()
def _ask_list(group: int, point: Doubles, chosen: Places, values: Doubles, store: Store) -> bool:
    """Write the features of a set from its list, if there is one; return whether that is proven."""
    metric, own = store.plan[METRIC], store.memory[group]
    first, listed = len(store.rows) + group * store.plan[ROOM], int(own[LISTED])
    if listed == 0:
        return False
    moved = length(distance(point, own[ANCHOR : ANCHOR + len(point)], metric), metric)
    measure(store.columns, first, first + listed, point, metric)
    return _select(first, first + listed, own[REACH] - moved, group, point, chosen, values, store)


@kernel()
def _ask_all(group: int, point: Doubles, before: Doubles, chosen: Places, values: Doubles, store: Store) -> None:
    """Write the features of a set from all its prototypes, by way of a new list where it is larger than one."""
    plan, own = store.plan, store.memory[group]
    start, end, first = plan[BOUNDS + group], plan[BOUNDS + group + 1], len(store.rows) + group * plan[ROOM]
    if plan[ROOM] >= end - start:
        measure(store.columns, start, end, point, plan[METRIC])
    else:
        step = length(distance(point, before, plan[METRIC]), plan[METRIC])
        listed = _list(group, 2.0 * step <= own[GAP], point, store)
        if listed > 0 and _select(first, first + listed, own[REACH], group, point, chosen, values, store):
            if own[LISTED] > 0.0:
                own[GAP] = own[REACH] - length(own[ANCHOR + len(point)], plan[METRIC])
            return
    _select(start, end, np.inf, group, point, chosen, values, store)


@kernel(
    f"i8(f8[:, ::1], i8[::1], f8[:, ::1], f4[:, ::1], i8[::1], i8[::1], f8[:, ::1], {READ_ONLY}, i8[::1], f8[::1])"
)
def nearest(
    ranges: Doubles, clips: Places, rows: Doubles, columns: Singles, places: Places, plan: Places, memory: Doubles,
    state: Doubles, chosen: Places, values: Doubles,
) -> int:  # fmt: skip
    """Write the nearest prototypes of a state, for each set and layer; return -1, or which signal is wrong.

    The last row of `ranges` is the state before, in the unit cube.
    """
    wrong = to_unit_cube(state, ranges, clips)
    if wrong >= 0:
        return wrong
    store, start, layers, point = Store(rows, columns, places, plan, memory), 0, plan[LAYERS], ranges[2]
    for group in range(plan[SETS]):
        first = BOUNDS + plan[SETS] + 1 + group * layers
        end = start + int(np.sum(plan[first : first + layers]))
        features, weights = chosen[start:end], values[start:end]
        if not _ask_list(group, point, features, weights, store):
            _ask_all(group, point, ranges[3], features, weights, store)
        start = end
    ranges[3] = point
    return -1


@kernel(f"i8(f8[:, ::1], i8[::1], f8[:, ::1], f4[:, ::1], i8[::1], i8, f8, {READ_ONLY}, i8[::1])")
def within(
    ranges: Doubles, clips: Places, rows: Doubles, columns: Singles, places: Places, metric: int, radius: float,
    state: Doubles, chosen: Places,
) -> int:  # fmt: skip
    """Write the prototypes nearer to a state than the radius; return how many, or -1 - which signal is wrong."""
    wrong = to_unit_cube(state, ranges, clips)
    if wrong >= 0:
        return -1 - wrong
    point, unsure, count = ranges[2], slack(radius, len(state), metric), 0
    measure(columns, 0, len(rows), point, metric)
    distances = columns[len(point)]
    for place in range(_keep(distances[: len(rows)], places, radius + unsure, 0, chosen)):
        k = chosen[place]
        if distances[k] < radius - unsure or distance(rows[k], point, metric) < radius:
            chosen[count] = k
            count += 1
    return count
