"""Measures feature coders through their public objects, each beside numpy in the same run.

The reference for selective Kanerva coding is what the literature does: difference, sum of squares, argpartition; a
form of it whose sum is an einsum is shown beside it, and faiss and scikit-learn where they are installed.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from _harness import Row, main
from _states import cube, in_turn, independent, slow_stream
from numpy.typing import NDArray

from rtagent.features import SelectiveKanerva, TileCoding, Tilings

SIGNALS, TILINGS, TILES = 12, 16, 8
Calls = dict[str, Callable[[Any], object]]


def numpy_nearest(prototypes: NDArray[np.float64], count: int) -> Callable[[NDArray[np.float64]], object]:
    return lambda state: np.argpartition(np.square(prototypes - state).sum(axis=1), count - 1)[:count]


def numpy_einsum(prototypes: NDArray[np.float64], count: int) -> Callable[[NDArray[np.float64]], object]:
    def nearest(state: NDArray[np.float64]) -> object:
        difference = prototypes - state
        return np.argpartition(np.einsum("ij,ij->i", difference, difference), count - 1)[:count]

    return nearest


def others(prototypes: NDArray[np.float64], count: int) -> Calls:
    """Return the libraries that are installed."""
    found: Calls = {}
    with contextlib.suppress(ImportError):
        import faiss

        index = faiss.IndexFlatL2(prototypes.shape[1])
        index.add(prototypes.astype(np.float32))
        found["faiss IndexFlatL2"] = lambda state: index.search(state[None].astype(np.float32), count)
    with contextlib.suppress(ImportError):
        from sklearn.neighbors import NearestNeighbors

        brute = NearestNeighbors(n_neighbors=count, algorithm="brute").fit(prototypes)
        found["scikit-learn brute"] = lambda state: brute.kneighbors(state[None], return_distance=False)
    return found


def kanerva(name: str, states: NDArray[np.float64], median: float, tail: float | None) -> Iterator[Row]:
    coder = SelectiveKanerva(state=cube(SIGNALS), prototypes=8000, eta=0.025)
    calls: Calls = {
        "rtagent": coder.encode,
        "numpy": numpy_nearest(coder.prototypes, coder.active),
        "numpy einsum": numpy_einsum(coder.prototypes, coder.active),
        **others(coder.prototypes, coder.active),
    }
    taken = in_turn(calls, states)
    own = taken["rtagent"]
    for who, each in taken.items():
        yield Row(f"SKC 8000, {name}: {who}, median", float(np.median(each)), "µs")
        yield Row(f"SKC 8000, {name}: {who}, p99", float(np.quantile(each, 0.99)), "µs")
    yield Row(f"SKC 8000, {name}: faster, median", ratio(taken["numpy"], own, 0.5), "×", median, "higher")
    yield Row(f"SKC 8000, {name}: faster, p99", ratio(taken["numpy"], own, 0.99), "×", tail, "higher")
    yield Row(f"SKC 8000, {name}: faster than einsum", ratio(taken["numpy einsum"], own, 0.5), "×")


def ratio(reference: NDArray[np.float64], own: NDArray[np.float64], quantile: float) -> float:
    return float(np.quantile(reference, quantile) / np.quantile(own, quantile))


def million() -> Iterator[Row]:
    coder = SelectiveKanerva(state=cube(SIGNALS), prototypes=1_000_000, eta=0.0002)
    prototypes = coder.prototypes

    def einsum(state: NDArray[np.float64]) -> object:
        difference = prototypes - state
        return np.einsum("ij,ij->i", difference, difference)

    calls: Calls = {
        "rtagent": coder.encode,
        "numpy pass": lambda state: np.square(prototypes - state).sum(axis=1),
        "numpy einsum pass": einsum,
    }
    taken = in_turn(calls, independent(60, SIGNALS), rounds=3)
    for who, each in taken.items():
        yield Row(f"SKC 10^6: {who}, median", float(np.median(each)) / 1e3, "ms")
    yield Row("SKC 10^6, independent: faster", ratio(taken["numpy pass"], taken["rtagent"], 0.5), "×", 5, "higher")
    yield Row("SKC 10^6: faster than einsum", ratio(taken["numpy einsum pass"], taken["rtagent"], 0.5), "×")


def numpy_tiles() -> Callable[[NDArray[np.float64]], object]:
    """Return the best numpy form: all tilings and signals at once."""
    low, high, spans = np.zeros(SIGNALS), np.ones(SIGNALS), np.full(SIGNALS, TILES + 1)
    steps = np.outer(np.arange(TILINGS), 2 * np.arange(SIGNALS) + 1) % TILINGS
    offsets, last, scale = steps / TILINGS, spans - 1, np.full(SIGNALS, float(TILES))
    strides = np.cumprod(np.concatenate(([1], spans[:-1])))
    starts = np.arange(TILINGS) * int(np.prod(spans))

    def encode(state: NDArray[np.float64]) -> object:
        unit = (np.minimum(np.maximum(state, low), high) - low) / (high - low)
        cells = np.floor(unit * scale + offsets).astype(np.int64)
        return np.minimum(cells, last) @ strides + starts

    return encode


def tiles() -> Iterator[Row]:
    coder = TileCoding(state=cube(SIGNALS), layers=(Tilings(TILINGS, TILES),))
    hashed = TileCoding(state=cube(SIGNALS), layers=(Tilings(TILINGS, TILES),), memory=1 << 20)
    calls: Calls = {"rtagent": coder.encode, "rtagent, hashed": hashed.encode, "numpy": numpy_tiles()}
    taken = in_turn(calls, slow_stream(10_000, SIGNALS))
    for who, each in taken.items():
        yield Row(f"tile coding: {who}, median", float(np.median(each)), "µs")
    yield Row("tile coding: faster, median", ratio(taken["numpy"], taken["rtagent"], 0.5), "×", 4, "higher")


def settle_allocator() -> None:
    """Make the allocator keep what numpy frees: page faults would make the references 3 times slower."""
    np.ones(3 << 20)


def rows() -> Iterator[Row]:
    settle_allocator()
    yield from kanerva("slow stream", slow_stream(5000, SIGNALS), 60, 10)
    yield from kanerva("independent", independent(5000, SIGNALS), 18, None)
    yield from million()
    yield from tiles()


if __name__ == "__main__":
    sys.exit(main(rows, __doc__))
