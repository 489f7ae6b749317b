"""The queue of transitions: each is learned once, in its order, and where learning is left off changes no bit."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import one_hot
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import Agent, Spec, clock, ms, us
from rtagent.backlog import Backlog, Desk, InLoop, Work, make_work, yield_once
from rtagent.errors import ScheduleError, SpecError
from rtagent.experience import FeatureVector, FloatArray, Sample, Transition
from rtagent.features import Tabular
from rtagent.learn import Full, Learn, When, Where
from rtagent.learning import (
    TD,
    Demon,
    Demons,
    ExpectedSarsa,
    Horde,
    Method,
    QLearning,
    Sarsa,
    TrueOnlineSarsa,
    TrueOnlineTD,
)
from rtagent.learning.cumulants import Signal
from rtagent.learning.lazy import LazyTraces
from rtagent.learning.lazy_trace import LazyTrace
from rtagent.policy import EpsilonGreedy
from rtagent.recorder import Recorder

RNG = np.random.Generator
SIGNALS = {"load": Spec(low=0.0, high=1.0), "speed": Spec(low=-1.0, high=1.0)}
ACTIONS = 3


# Learning, outside of a run


class Ticking:
    """A clock on which every look at it takes 1 ns: a slice of n ns is n pieces of work."""

    virtual = False

    def __init__(self) -> None:
        self.time = 0

    def now(self) -> int:
        self.time += 1
        return self.time

    async def compute(self, cost: int) -> None:
        self.time += cost


class RandomSenses:
    """Senses that have news, and that are urgent, at random."""

    paced = True

    def __init__(self, rng: RNG, news: float = 0.5) -> None:
        self._rng, self._chance = rng, news
        self.watched = self.told = 0

    def watch(self) -> None:
        self.watched += 1

    def news(self) -> bool:
        told = bool(self._rng.random() < self._chance)
        self.told += told
        return told

    async def newest(self) -> Mapping[str, Sample]:
        return {}


class Told:
    """Keeps what learning told the run."""

    def __init__(self) -> None:
        self.transitions: list[Transition] = []
        self.deltas: list[float] = []
        self.errors: list[BaseException] = []
        self.recorder = Recorder()

    def learned(self, transition: Transition, delta: float) -> None:
        self.transitions.append(transition)
        self.deltas.append(delta)

    def desk(self, cost: int = 0, own_clock: Any = None) -> Desk:
        at = own_clock or clock.current()
        return Desk(at, self.recorder, lambda: cost, lambda: 0, self.learned, self.errors.append, costs=cost > 0)


class Never:
    by_prediction = False

    async def __call__(self) -> bool:
        return False


class AtRandom:
    """Urgent at random."""

    by_prediction = False

    def __init__(self, rng: RNG) -> None:
        self._rng = rng

    async def __call__(self) -> bool:
        return bool(self._rng.random() < 0.5)


def agent_of(learner: Any) -> Agent:
    return Agent(Tabular(state={"place": Spec.discrete(2)}), learner)


def counts(told: Told) -> dict[str, int]:
    return {name: count for name, count in told.recorder.counters.items() if count}


# Experience


def vector(rng: RNG, size: int, active: int, real: bool) -> FeatureVector:
    indices = np.sort(rng.permutation(size)[:active])
    return FeatureVector(indices, rng.normal(size=active) if real else None)


def experience(rng: RNG, count: int, size: int, active: int, actions: int = 1) -> list[Transition]:
    """Return episodes of random features, which terminate, are truncated, or are cut without a word."""
    found: list[Transition] = []
    real = bool(rng.random() < 0.3)
    before, action = vector(rng, size, active, real), int(rng.integers(actions))
    state = rng.random(2)
    for _ in range(count):
        after, then, following = vector(rng, size, active, real), int(rng.integers(actions)), rng.random(2)
        ended, truncated, cut = rng.random(3) < (0.03, 0.03, 0.02)
        reward = float(rng.normal())
        found.append(
            Transition(
                before, action, 0.5, reward, after, then, 100 * ms, bool(ended), bool(truncated), state, following
            )
        )
        before, action, state = after, then, following
        if ended or truncated or cut:
            before = vector(rng, size, active, real)
    return found


# Every learner whose work can be interrupted

Maker = Callable[[int, int], Any]


def quickly(kind: Any, **more: Any) -> Maker:
    """Return a maker of a scalar learner whose trace shrinks so fast that it is folded again and again."""
    return lambda size, active: kind(size=size, active=active, alpha=0.05, gamma=0.5, lambda_=0.5, **more)


def horde(*demons: Demons | Demon, **more: Any) -> Maker:
    return lambda size, active: Horde(size=size, active=active, state=SIGNALS, demons=demons, alpha=0.05, **more)


LEARNERS: dict[str, Maker] = {
    "td": quickly(TD),
    "true_online_td": quickly(TrueOnlineTD),
    "sarsa": quickly(Sarsa, actions=ACTIONS),
    "true_online_sarsa": quickly(TrueOnlineSarsa, actions=ACTIONS),
    "q_learning": quickly(QLearning, actions=1),  # so that none explores, which would cut its traces
    "expected_sarsa": quickly(ExpectedSarsa, actions=ACTIONS, policy=EpsilonGreedy(epsilon=0.1)),
    "horde": horde(Demons(gammas=(0.0, 0.5, 0.9), bins=9), rupee=True),
    "horde, one by one": horde(Demons(learner="td"), Demons(learner="swift_td", name="swift")),
    "horde, off policy": horde(
        Demon("stay", Signal(0), policy=(1.0, 0.0, 0.0), method=Method("gtd", alpha=0.02, lambda_=0.0)),
        Demons(bins=5),
        measured=3,
    ),
    "horde on a horde": horde(
        Demons(signals=("load",), name="below"), Demons(signals=("speed",), bins=20, on=("below",))
    ),
}
SCALAR = [name for name in LEARNERS if not name.startswith("horde")]


def sizes(name: str, form: str) -> tuple[int, int]:
    """Return the size and the active features with which a learner runs in this form, and folds in pieces."""
    if form == "plain":
        return 12, 1
    return (6000, 1500) if name in SCALAR else (200, 40)


def experience_of(name: str, form: str, rng: RNG) -> list[Transition]:
    return experience(rng, 25, *sizes(name, form), actions=1 if name == "q_learning" else ACTIONS)


def made(name: str, form: str) -> Any:
    learner = LEARNERS[name](*sizes(name, form))
    if isinstance(learner, Horde):
        for group in learner.groups:
            if isinstance(group.learned, LazyTrace):
                group.learned.slice_bytes = 500  # so that even a few demons are many slices
    return learner


@pytest.fixture(autouse=True, scope="module")
def _small_blocks() -> Iterator[None]:
    """Let folds be cut into many pieces."""
    patch = pytest.MonkeyPatch()
    before = LazyTraces.folding

    def folding(self: LazyTraces) -> Generator[None, None, None]:
        while self._cells[-2, self._kernels.FOLDED] >= 0.0:
            yield
            self._kernels.fold(self._cells, 500)

    assert before.__code__.co_names.count("BLOCK") == 1, "this test replaces the size of the blocks alone"
    patch.setattr(LazyTraces, "folding", folding)
    yield
    patch.undo()


def look_at(learner: Any, features: FeatureVector) -> Any:
    """Ask a learner for what it thinks of a state, as a choice does."""
    return learner.action_values(features) if hasattr(learner, "action_values") else learner.predict(features)


def bits(saved: Any) -> Any:
    """Return a saved state as what can be compared bit for bit."""
    if isinstance(saved, Mapping):
        return {name: bits(value) for name, value in saved.items()}
    if isinstance(saved, list | tuple):
        return [bits(value) for value in saved]
    if isinstance(saved, np.ndarray):
        return saved.dtype.str, saved.shape, saved.tobytes()
    return np.float64(saved).tobytes() if isinstance(saved, float) else saved


async def learn_interrupted(
    learner: Any, transitions: list[Transition], rules: Learn, rng: RNG, urgency: Any = None
) -> Told:
    """Learn in a loop that is called away at random, and that looks at the weights wherever it was."""
    told, agent = Told(), agent_of(learner)
    backlog = Backlog(agent, rules, told.desk(cost=2, own_clock=Ticking()))
    work = InLoop(backlog, RandomSenses(rng), urgency or Never())  # type: ignore[arg-type]  # scripted
    for transition in transitions:
        agent.queue.append(transition)
        await work.learn()
        assert len(agent.queue) <= rules.queue
        if rng.random() < 0.5:
            look_at(learner, transitions[int(rng.integers(len(transitions)))].features)
    await work.drain(None)
    assert work.length == 0
    return told


def learned_at_once(name: str, form: str, transitions: list[Transition]) -> tuple[Any, list[float]]:
    learner = made(name, form)
    return learner, [learner.update(replace(transition)) for transition in transitions]


@pytest.mark.parametrize("form", ["compiled", "plain"])
@pytest.mark.parametrize("name", LEARNERS)
@given(seed=st.integers(0, 2**32 - 1), pieces=st.integers(1, 3), queue=st.integers(1, 6))
@settings(max_examples=6)
def test_interrupting_any_learner_anywhere_changes_nothing(
    name: str, form: str, seed: int, pieces: int, queue: int
) -> None:
    rng = np.random.default_rng(seed)
    transitions = experience_of(name, form, rng)
    straight, deltas = learned_at_once(name, form, transitions)
    learner = made(name, form)
    told = clock.run(learn_interrupted(learner, transitions, Learn(slice=pieces, queue=queue), rng))
    assert all(one is other for one, other in zip(told.transitions, transitions, strict=True)), (
        "first in, first out"
    )
    assert bits(told.deltas) == bits(deltas)
    assert bits(learner.save()) == bits(straight.save())
    assert sum(counts(told).values()) == len(transitions)


@pytest.mark.parametrize("name", ["sarsa", "true_online_td", "horde"])
@given(seed=st.integers(0, 2**32 - 1), sliced=st.booleans())
@settings(max_examples=5)
def test_waiting_for_calm_changes_nothing_either(name: str, seed: int, sliced: bool) -> None:
    rng = np.random.default_rng(seed)
    transitions = experience_of(name, "compiled", rng)
    straight, deltas = learned_at_once(name, "compiled", transitions)
    learner = made(name, "compiled")
    rules = Learn(when=When.CALM, slice=2 * sliced, queue=5)
    told = clock.run(learn_interrupted(learner, transitions, rules, rng, AtRandom(rng)))
    assert bits(told.deltas) == bits(deltas)
    assert bits(learner.save()) == bits(straight.save())


@pytest.mark.parametrize("name", LEARNERS)
def test_the_interruptions_of_these_tests_come_in_the_middle_of_updates(name: str) -> None:
    transitions = experience_of(name, "compiled", np.random.default_rng(2))
    learner = made(name, "compiled")
    pieces = [sum(1 for _ in learner.updating(transition)) for transition in transitions]
    assert max(pieces) >= 2


@pytest.mark.parametrize("name", SCALAR)
@pytest.mark.parametrize("form", ["compiled", "plain"])
def test_a_choice_made_while_a_scalar_learner_is_at_it_has_learned_the_transition(name: str, form: str) -> None:
    rng = np.random.default_rng(5)
    transitions = experience_of(name, form, rng)
    straight, learner = made(name, form), made(name, form)
    for transition in transitions:
        straight.update(transition)
        seen = bits(look_at(straight, transition.next_features))
        for _ in learner.updating(transition):
            assert bits(look_at(learner, transition.next_features)) == seen


@pytest.mark.parametrize("name", ["horde", "horde, one by one", "horde, off policy"])
def test_a_choice_made_while_a_horde_is_at_it_finds_each_demon_before_or_after(name: str) -> None:
    size, active = 60, 8
    rng = np.random.default_rng(6)
    learner = LEARNERS[name](size, active)
    for group in learner.groups:
        group.learned.slice_bytes = 50
    mixed = 0
    for transition in experience(rng, 40, size, active):
        probe = vector(rng, size, active, real=False)
        before, twin = learner.predict(probe), LEARNERS[name](size, active)
        twin.restore(learner.save())
        twin.update(transition)
        after = twin.predict(probe)
        for _ in learner.updating(transition):
            during = learner.predict(probe)
            near = [np.isclose(during, each, rtol=1e-4, atol=1e-5) for each in (before, after)]
            assert np.all(near[0] | near[1])
            mixed += bool(near[0].sum() and not near[0].all() and near[1].sum() and not near[1].all())
    assert mixed > 0, "some had learned, and others not yet"


# A learner whose pieces can be seen


class Pair:
    """Writes two numbers that are equal but in the middle of a piece."""

    needs_next_action = False

    def __init__(self, pieces: int = 4, pause: float = 0.0) -> None:
        self.one = self.other = 0
        self._pieces, self._pause = pieces, pause
        self.learned: list[Transition] = []

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        self.learned.append(transition)
        for _ in range(self._pieces):
            self.one += 1
            if self._pause:
                time.sleep(self._pause)  # another thread may look now
            self.other += 1
            yield
        return transition.reward

    def update(self, transition: Transition) -> float:
        pieces = self.updating(transition)
        while True:
            try:
                next(pieces)
            except StopIteration as done:
                return float(done.value)

    def predict(self, features: FeatureVector) -> float:
        return float(self.one)

    def action_values(self, features: FeatureVector) -> FloatArray:
        return np.zeros(ACTIONS)


def numbered(count: int) -> list[Transition]:
    """Return transitions whose reward is their number, and which are complete at that time (ns)."""
    found = []
    for number in range(count):
        made = Transition(one_hot(0), None, 1.0, float(number), one_hot(1), None, 0, False, False)
        made.complete_at = number
        found.append(made)
    return found


class Bench:
    """A backlog of a `Pair` (or another learner), with what learns, on the running loop."""

    def __init__(self, rules: Learn, learner: Any = None, *, virtual: bool = False, cost: int = 0) -> None:
        self.learner = learner or Pair()
        self.told, self.agent = Told(), agent_of(self.learner)
        self.senses = RandomSenses(np.random.default_rng(0), news=0.0)
        backlog = Backlog(self.agent, rules, self.told.desk(cost))
        self.work: Work = make_work(backlog, self.senses, Never(), virtual=virtual)  # type: ignore[arg-type]  # scripted

    @property
    def numbers(self) -> list[int]:
        """Which transitions were learned, in their order."""
        return [int(transition.reward) for transition in self.told.transitions]

    async def give(self, *transitions: Transition) -> None:
        self.agent.queue.extend(transitions)
        await self.work.learn()


RULES = {
    "inline": Learn(),
    "deferred": Learn(when=When.CALM),
    "interruptible": Learn(slice=100 * us),
    "background": Learn(where=Where.THREAD),
}
CLOCKS: list[tuple[str, clock.ClockName]] = [
    (name, each) for name in RULES for each in ("real", "virtual") if (name, each) != ("deferred", "real")
]  # type: ignore[misc]  # each is one of the two names


def on_bench(rules: Learn, clock_name: clock.ClockName, story: Callable[[Bench], Any], **settings: Any) -> Bench:
    """Tell a story on a bench under a clock."""

    async def main() -> Bench:
        bench = Bench(rules, virtual=clock_name == "virtual", **settings)
        try:
            await story(bench)
        finally:
            bench.work.close()
        return bench

    return clock.run(main(), clock_name)


@pytest.mark.parametrize(("name", "clock_name"), CLOCKS)
def test_what_is_left_is_learned_at_the_end(name: str, clock_name: clock.ClockName) -> None:
    async def story(bench: Bench) -> None:
        await bench.give(*numbered(20))
        bench.agent.queue.extend(numbered(25)[20:])
        await bench.work.drain(None)
        assert bench.work.length == 0

    bench = on_bench(RULES[name], clock_name, story, cost=ms)
    assert bench.numbers == list(range(25))
    assert sum(counts(bench.told).values()) == 25


@pytest.mark.parametrize(("name", "clock_name"), CLOCKS)
def test_after_a_signal_learning_ends_at_its_deadline_and_the_rest_is_counted(
    name: str, clock_name: clock.ClockName
) -> None:
    async def story(bench: Bench) -> None:
        bench.agent.queue.extend(numbered(100))
        await bench.work.drain(clock.current().now() + 40 * ms)
        assert bench.work.length == 0

    pause = 2.5e-3 if clock_name == "real" else 0.0
    bench = on_bench(RULES[name], clock_name, story, learner=Pair(pause=pause), cost=10 * ms)
    told = counts(bench.told)
    lost = told.get("transitions_not_learned", 0)
    assert bench.numbers == list(range(100 - lost)), "the oldest first"
    assert sum(told.values()) == 100
    if clock_name == "virtual" and name != "background":
        assert lost == 0, "what learning is said to cost is left out"
    else:
        assert 0 < len(bench.numbers) < 20


@pytest.mark.parametrize(("name", "clock_name"), CLOCKS)
@pytest.mark.parametrize("many", [1, 7])
def test_the_queue_never_holds_more_than_it_may(name: str, clock_name: clock.ClockName, many: int) -> None:
    async def story(bench: Bench) -> None:
        for number in range(0, 35, many):
            bench.agent.queue.extend(numbered(35)[number : number + many])
            await bench.work.relieve()
            assert len(bench.agent.queue) <= 3
        await bench.work.drain(None)

    bench = on_bench(replace(RULES[name], queue=3), clock_name, story, cost=us)
    assert bench.numbers == list(range(35))
    told = counts(bench.told)
    assert sum(told.values()) == 35
    assert told["learned_under_backpressure"] > 0


@pytest.mark.parametrize(("name", "clock_name"), CLOCKS)
@pytest.mark.parametrize("many", [1, 4])
def test_what_is_shed_is_the_newest_and_the_trace_is_cut_there(
    name: str, clock_name: clock.ClockName, many: int
) -> None:
    async def story(bench: Bench) -> None:
        bench.agent.queue.extend(numbered(3))
        for number in range(3, 11, many):
            bench.agent.queue.extend(numbered(11)[number : number + many])
            await bench.work.relieve()
            assert len(bench.agent.queue) <= 3
        await bench.work.drain(None)

    bench = on_bench(replace(RULES[name], queue=3, full=Full.SHED), clock_name, story)
    assert bench.numbers == [0, 1, 2]
    assert counts(bench.told)["transitions_shed"] == 8
    assert [transition.truncated for transition in bench.told.transitions] == [False, False, True]


def test_after_a_gap_learning_is_that_of_an_episode_that_was_truncated_there() -> None:
    transitions = experience(np.random.default_rng(8), 30, 60, 8)
    straight = TrueOnlineTD(size=60, active=8)
    for number, transition in enumerate(transitions):
        if not 10 <= number < 13:
            straight.update(replace(transition, truncated=transition.truncated or number == 9))

    async def story(bench: Bench) -> None:
        for number, transition in enumerate(transitions):
            bench.agent.queue.append(transition)
            await (bench.work.relieve() if 9 <= number < 12 else bench.work.learn())

    rules = Learn(slice=100 * us, queue=1, full=Full.SHED)
    bench = on_bench(rules, "virtual", story, learner=TrueOnlineTD(size=60, active=8))
    assert counts(bench.told)["transitions_shed"] == 3
    assert bits(bench.learner.save()) == bits(straight.save())


# Learning that raises


class Failing(Pair):
    """Raises in the middle of its sixth transition."""

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        if len(self.learned) == 5:
            yield
            raise RuntimeError("lost my weights")
        return (yield from super().updating(transition))


class FailingEarly(Pair):
    """Raises before there is a generator."""

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        if len(self.learned) == 5:
            raise RuntimeError("lost my weights")
        return super().updating(transition)


@pytest.mark.parametrize("kind", [Failing, FailingEarly])
@pytest.mark.parametrize(("name", "clock_name"), CLOCKS)
def test_learning_that_raises_is_over(name: str, clock_name: clock.ClockName, kind: type[Pair]) -> None:
    async def story(bench: Bench) -> None:
        await bench.give(*numbered(40))
        await bench.work.drain(None)
        assert bench.work.length == 0

    bench = on_bench(RULES[name], clock_name, story, learner=kind())
    assert bench.numbers == [0, 1, 2, 3, 4]
    assert len(bench.learner.learned) == 5, "nothing is learned after it"
    assert [str(error) for error in bench.told.errors] == ["lost my weights"], "told once"
    assert not bench.agent.keeps_transitions
    assert sum(counts(bench.told).values()) == 40
    assert counts(bench.told)["transitions_not_learned"] == 35


# The thread


def test_who_reads_the_weights_beside_a_thread_sees_only_whole_pieces() -> None:
    torn_without = 0

    async def story(bench: Bench) -> None:
        nonlocal torn_without
        await bench.give(*numbered(100))
        while bench.work.length:
            torn_without += bench.learner.one != bench.learner.other
            with bench.work.weights:
                one, _, other = bench.learner.one, time.sleep(20e-6), bench.learner.other  # noqa: ASYNC251  # its chance
            assert one == other
            await yield_once()

    bench = on_bench(RULES["background"], "real", story, learner=Pair(pieces=10, pause=20e-6))
    assert bench.learner.one == bench.learner.other == 1000
    assert torn_without > 0, "without looking at whole pieces only, this test sees halves"


def test_who_asks_for_the_weights_again_and_again_does_not_starve_the_thread() -> None:
    async def story(bench: Bench) -> None:
        await bench.give(*numbered(8))
        looks = 0
        async with asyncio.timeout(30):
            while bench.work.length:
                with bench.work.weights:
                    looks += 1
                if looks % 100 == 0:
                    await yield_once()

    assert on_bench(RULES["background"], "real", story).numbers == list(range(8))


@pytest.mark.parametrize("name", ["sarsa", "true_online_sarsa", "horde", "horde on a horde"])
def test_a_thread_learns_what_is_learned_at_once(name: str) -> None:
    transitions = experience_of(name, "compiled", np.random.default_rng(4))
    straight, deltas = learned_at_once(name, "compiled", transitions)

    async def story(bench: Bench) -> None:
        for transition in transitions:
            await bench.give(transition)
            with bench.work.weights:
                look_at(bench.learner, transition.features)
            await yield_once()
        await bench.work.drain(None)

    bench = on_bench(RULES["background"], "real", story, learner=made(name, "compiled"))
    assert bits(bench.told.deltas) == bits(deltas)
    assert bits(bench.learner.save()) == bits(straight.save())


@pytest.mark.parametrize("clock_name", ["real", "virtual"])
def test_no_thread_is_left(clock_name: clock.ClockName) -> None:
    async def story(bench: Bench) -> None:
        await bench.give(*numbered(3))

    before = threading.active_count()
    on_bench(RULES["background"], clock_name, story)
    assert threading.active_count() == before


# What cannot work


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"slice": -1}, "learn.slice is negative"),
        ({"queue": 0}, "give room for 1 transition or more"),
        ({"when": "never"}, "learn.when is 'never': use one of always, calm"),
        ({"where": "moon"}, "learn.where is 'moon': use one of loop, thread"),
        ({"full": "panic"}, "learn.full is 'panic': use one of block, shed"),
        ({"when": "calm", "where": "thread"}, "a thread learns all the time"),
        ({"slice": 1000, "where": "thread"}, "a thread learns all the time"),
    ],
)
def test_a_rule_that_cannot_work_is_refused(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ScheduleError, match=sentence):
        Learn(**settings)


@pytest.mark.parametrize("form", ["compiled", "plain"])
@pytest.mark.parametrize("name", SCALAR)
def test_what_grows_beyond_all_bounds_leaves_weights_that_can_be_chosen_from(name: str, form: str) -> None:
    learner = made(name, form)
    learner.alpha = 1000.0
    transitions = experience_of(name, form, np.random.default_rng(3))

    def diverge() -> None:
        for transition in 20 * transitions:
            learner.update(transition)

    with pytest.raises(SpecError, match="the weights have grown beyond all bounds"):
        diverge()
    assert np.isfinite(look_at(learner, transitions[0].features)).all()
