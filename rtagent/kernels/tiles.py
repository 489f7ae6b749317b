"""Tile coding, compiled.

`plan` has a row for each of the layers: its number of tilings, its number of axes, the number of its first tile,
and how many tiles a tiling has; then one for each axis of each layer: the signal, the number of tiles along it,
the stride from one to the next, and whether it wraps. `offsets` has, for each axis, its tiles per unit and then the
displacement of each tiling.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtagent.kernels.compiling import kernel
from rtagent.kernels.normalise import READ_ONLY, to_unit_cube

Numbers = NDArray[np.int64]
Reals = NDArray[np.float64]


@kernel(f"i8(f8[:, ::1], i8[::1], i8, i8[:, ::1], f8[::1], {READ_ONLY}, i8[::1])")
def find(
    ranges: Reals, clips: Numbers, layers: int, plan: Numbers, offsets: Reals, state: Reals, tiles: Numbers
) -> int:
    """Write the tiles of a state, layer by layer; return -1, or the place of the first signal that is wrong."""
    wrong = to_unit_cube(state, ranges, clips)
    if wrong >= 0:
        return wrong
    start, axis, place = 0, layers, 0
    for layer in range(layers):
        tilings, dimensions = plan[layer, 0], plan[layer, 1]
        own = tiles[start : start + tilings]
        for tiling in range(tilings):
            own[tiling] = plan[layer, 2] + tiling * plan[layer, 3]
        for row in range(axis, axis + dimensions):
            signal, span, stride = plan[row, 0], plan[row, 1], plan[row, 2]
            # the upper end of a range belongs to the last tile, or, where it wraps, to the first
            beyond = -span if plan[row, 3] else -1
            position, displaced = ranges[2, signal] * offsets[place], offsets[place + 1 : place + 1 + tilings]
            for tiling in range(tilings):
                cell = np.int64(position + displaced[tiling])
                own[tiling] += (cell + beyond if cell >= span else cell) * stride
            place += 1 + tilings
        start, axis = start + tilings, axis + dimensions
    return -1


@kernel()
def _mixed(number: np.uint64) -> np.uint64:
    number += np.uint64(0x9E3779B97F4A7C15)
    number = (number ^ (number >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    number = (number ^ (number >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return number ^ (number >> np.uint64(31))


@kernel("b1(i8[::1], i8[::1], i8[::1])")
def place(tiles: Numbers, places: Numbers, owners: Numbers) -> bool:
    """Write where tiles are in a hashed memory, taking what is free; return whether another owns one of them."""
    shared = False
    for k in range(len(tiles)):
        places[k] = np.int64(_mixed(np.uint64(tiles[k])) % np.uint64(len(owners)))
        if owners[places[k]] < 0:
            owners[places[k]] = tiles[k]
        shared |= owners[places[k]] != tiles[k]
    return shared


@kernel("i8(i8[::1], f8[::1])")
def merge(places: Numbers, counts: Reals) -> int:
    """Sort places and merge those that are alike, in place, counting each; return how many are left."""
    places.sort()
    kept = 0
    for k in range(len(places)):
        if k > 0 and places[k] == places[kept - 1]:
            counts[kept - 1] += 1.0
        else:
            places[kept], counts[kept] = places[k], 1.0
            kept += 1
    return kept
