"""How quickly learners learn, against well-written numpy and against the memory, each ratio within this run.

The stream of states is a random walk in the unit cube (σ 0.005 in each of 12 dimensions), or independent states;
the features are selective Kanerva coding, 8000 prototypes, 200 active. γ is 0.9 and λ 0.99, as in the thesis,
chapter 4. Everything is measured through the public objects, cumulants and compared returns included.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from time import perf_counter

import numpy as np
from _harness import Row, main
from numpy.typing import NDArray

from rtagent import Spec
from rtagent.experience import FeatureVector, Transition
from rtagent.features import SelectiveKanerva
from rtagent.learning import Demons, Horde, SwiftTD, TrueOnlineTD

DIMENSIONS, SIZE, ACTIVE = 12, 8000, 200
GAMMA, LAMBDA, ALPHA = 0.9, 0.99, 0.1
STATE = {f"signal_{number}": Spec(low=0.0, high=1.0) for number in range(DIMENSIONS)}
STREAM_BYTES = 96
SETTLING = 400
"""Steps until the traces of what was before are forgotten."""

Times = NDArray[np.float64]
Signals = NDArray[np.float64]


def stream(count: int, *, slow: bool, seed: int = 0) -> list[Transition]:
    """Return transitions between states of a stream."""
    rng = np.random.default_rng(seed)
    coder = SelectiveKanerva(state=STATE, prototypes=SIZE, eta=ACTIVE / SIZE)
    state = rng.random(DIMENSIONS)
    seen = []
    for _ in range(count + 1):
        state = np.clip(state + rng.normal(0, 0.005, DIMENSIONS), 0, 1) if slow else rng.random(DIMENSIONS)
        seen.append((state, coder.encode(state)))
    return [_transition(*here, *there) for here, there in pairwise(seen)]


def _transition(
    state: NDArray[np.float64],
    features: FeatureVector,
    next_state: NDArray[np.float64],
    next_features: FeatureVector,
) -> Transition:
    reward = 0.1 * float(next_state[0])
    return Transition(features, None, 1.0, reward, next_features, None, 0, False, False, state, next_state)


def timed(work: Callable[[Transition], object], transitions: list[Transition]) -> Times:
    """Return how long each step took, in seconds."""
    times = []
    for transition in transitions:
        start = perf_counter()
        work(transition)
        times.append(perf_counter() - start)
    return np.array(times)


def dense_td() -> Callable[[Transition], None]:
    """Return true online TD(λ) in numpy, on all weights."""
    theta, trace, alpha = np.zeros(SIZE), np.zeros(SIZE), ALPHA / ACTIVE
    estimate = 0.0

    def step(t: Transition) -> None:
        nonlocal estimate
        here, there = t.features.indices, t.next_features.indices
        value, following = theta[here].sum(), theta[there].sum()
        delta = t.reward + GAMMA * following - estimate
        np.multiply(trace, GAMMA * LAMBDA, out=trace)
        trace[here] += alpha * (1.0 - trace[here].sum())
        np.add(theta, delta * trace, out=theta)
        theta[here] += alpha * (estimate - value)
        estimate = following

    return step


def indexed_td() -> Callable[[Transition], None]:
    """Return the same on the weights whose trace is above 1e-3 of the largest only."""
    theta, trace, alpha = np.zeros(SIZE), np.zeros(SIZE), ALPHA / ACTIVE
    estimate, eligible = 0.0, np.zeros(0, dtype=np.intp)

    def step(t: Transition) -> None:
        nonlocal estimate, eligible
        here, there = t.features.indices, t.next_features.indices
        value, following = theta[here].sum(), theta[there].sum()
        delta = t.reward + GAMMA * following - estimate
        faded = trace[eligible] * (GAMMA * LAMBDA)
        trace[eligible] = faded
        fresh = here[trace[here] == 0.0]
        trace[here] += alpha * (1.0 - trace[here].sum())
        trace[eligible[faded < 1e-3 * alpha]] = 0.0
        eligible = np.concatenate((eligible[faded >= 1e-3 * alpha], fresh))
        theta[eligible] += delta * trace[eligible]
        theta[here] += alpha * (estimate - value)
        estimate = following

    return step


def single_learners() -> Iterator[Row]:
    """Yield the rows of learners of one prediction."""
    transitions = stream(6000, slow=True)
    ours = TrueOnlineTD(size=SIZE, active=ACTIVE, alpha=ALPHA, gamma=GAMMA, lambda_=LAMBDA)
    swift = SwiftTD(size=SIZE, active=ACTIVE, alpha=ALPHA, gamma=GAMMA, lambda_=LAMBDA)
    kinds: dict[str, Callable[[Transition], object]] = {
        "ours": ours.update, "dense": dense_td(), "indexed": indexed_td(), "SwiftTD": swift.update,
    }  # fmt: skip
    blocks: dict[str, list[float]] = {name: [] for name in kinds}
    for first in range(0, len(transitions), 1000):
        for name, work in kinds.items():
            blocks[name] += timed(work, transitions[first : first + 1000])[200:].tolist()
    medians = {name: float(np.median(times)) for name, times in blocks.items()}
    yield Row("true online TD(λ): update", medians["ours"] * 1e6, "µs")
    yield Row("  numpy on all weights", medians["dense"] * 1e6, "µs")
    yield Row("  numpy on active indices", medians["indexed"] * 1e6, "µs")
    yield Row("  numpy on active indices / ours", medians["indexed"] / medians["ours"], "×", 5, "higher")
    yield Row("SwiftTD: update", medians["SwiftTD"] * 1e6, "µs")


def make_horde(demons: int) -> Horde:
    """Return a Horde of so many demons: each signal, and how long it will be in each of many parts of its range."""
    each = Demons(gammas=(GAMMA,), bins=demons // DIMENSIONS - 1, alpha=ALPHA, lambda_=LAMBDA)
    return Horde(size=SIZE, active=ACTIVE, state=STATE, demons=(each,))


def numpy_horde(demons: int) -> Callable[[Transition], None]:
    """Return the numpy form: weights by features, rows with a trace above 1e-3 of the largest only."""
    weights, estimate = np.zeros((SIZE, demons), np.float32), np.zeros(demons, np.float32)
    trace, alpha = np.zeros(SIZE), ALPHA / ACTIVE
    signal = np.arange(demons) % DIMENSIONS
    low = np.random.default_rng(0).random(demons)

    def step(t: Transition) -> None:
        nonlocal estimate
        here, there = t.features.indices, t.next_features.indices
        values = np.asarray(t.next_state)[signal]
        cumulants = (0.1 * ((low <= values) & (values < low + 0.1))).astype(np.float32)
        value, following = weights[here].sum(axis=0), weights[there].sum(axis=0)
        delta = cumulants + np.float32(GAMMA) * following - estimate
        np.multiply(trace, GAMMA * LAMBDA, out=trace)
        trace[here] += alpha * (1.0 - trace[here].sum())
        eligible = np.flatnonzero(trace > 1e-3 * alpha)
        weights[eligible] += np.outer(trace[eligible].astype(np.float32), delta)
        weights[here] += np.float32(alpha) * (estimate - value)
        estimate = following

    return step


def touched(horde: Horde, steps: int = 200) -> Horde:
    """Return a Horde all of whose weights have their place in memory."""
    for transition in stream(steps, slow=False, seed=9):
        horde.update(transition)
    return horde


def stream_memory(demons: int, repeats: int = 300) -> float:
    """Return the median time (s) to move 96 bytes a demon through memory, half of it in and half of it out."""
    window = demons * STREAM_BYTES // 2 // 4
    memory = np.ones(max(window * 8, 1 << 29), np.float32)
    places = range(0, memory.size - window, window)
    times = []
    for number in range(repeats):
        part = memory[places[number % len(places)] :][:window]
        start = perf_counter()
        np.add(part, 1.0, out=part)
        times.append(perf_counter() - start)
    return float(np.median(times))


def slice_times(horde: Horde, transitions: list[Transition]) -> Times:
    """Return how long each slice took, in seconds."""
    times = []
    for transition in transitions:
        start = perf_counter()
        for _ in horde.updating(transition):
            now = perf_counter()
            times.append(now - start)
            start = perf_counter()
    return np.array(times)


def against_numpy(name: str, demons: int, *, slow: bool, reach: float) -> Iterator[Row]:
    """Yield the rows of a Horde beside numpy: means, folds included."""
    horde, reference = touched(make_horde(demons)), numpy_horde(demons)
    timed(reference, stream(40, slow=False, seed=9))
    transitions = stream(SETTLING + 2000 if slow else 400, slow=slow)
    settling, rest = (SETTLING, 40) if slow else (100, 12)
    timed(horde.update, transitions[:settling])
    timed(reference, transitions[settling - 100 : settling])
    ours, theirs = [], []
    for first in range(settling, len(transitions), len(transitions) // 5):
        block = transitions[first : first + len(transitions) // 5]
        ours += timed(horde.update, block).tolist()
        theirs += timed(reference, block[:rest]).tolist()
    slices = slice_times(horde, transitions[settling : settling + 300])
    scale = 1e9 / demons
    yield Row(f"{name}: median", float(np.median(ours)) * scale, "ns/demon")
    yield Row("  mean", float(np.mean(ours)) * scale, "ns/demon")
    yield Row("  numpy: mean", float(np.mean(theirs)) * scale, "ns/demon")
    yield Row("  numpy / ours, means", float(np.mean(theirs) / np.mean(ours)), "×", reach, "higher")
    yield Row("  slices: median", float(np.median(slices)) * 1e6, "µs")
    yield Row("  slices: p99", float(np.quantile(slices, 0.99)) * 1e6, "µs", 100)


def against_memory(demons: int) -> Iterator[Row]:
    """Yield the rows of a large Horde beside moving 96 bytes a demon."""
    horde = touched(make_horde(demons), 150)
    transitions = stream(SETTLING + 600, slow=True)
    timed(horde.update, transitions[:SETTLING])
    ours, memory = [], []
    for first in range(SETTLING, len(transitions), 150):
        memory.append(stream_memory(demons))
        ours += timed(horde.update, transitions[first : first + 150]).tolist()
    slices = slice_times(horde, transitions[SETTLING : SETTLING + 200])
    limit, scale = float(np.median(memory)), 1e9 / demons
    yield Row(f"Horde of {demons:,}, slow stream: median", float(np.median(ours)) * 1e3, "ms")
    yield Row("  median", float(np.median(ours)) * scale, "ns/demon")
    yield Row("  mean", float(np.mean(ours)) * scale, "ns/demon")
    yield Row("  96 bytes through memory", limit * scale, "ns/demon")
    yield Row("  median / memory", float(np.median(ours)) / limit, "×", 2)
    yield Row("  mean / memory", float(np.mean(ours)) / limit, "×", 5)
    yield Row("  slices: median", float(np.median(slices)) * 1e6, "µs")
    yield Row("  slices: p99", float(np.quantile(slices, 0.99)) * 1e6, "µs", 100)


def rows() -> Iterator[Row]:
    """Measure everything."""
    yield from single_learners()
    yield from against_numpy("Horde of 15,000, slow stream", 15_000, slow=True, reach=50)
    yield from against_numpy("Horde of 15,000, independent states", 15_000, slow=False, reach=30)
    yield from against_memory(150_000)


if __name__ == "__main__":
    sys.exit(main(rows, __doc__))
