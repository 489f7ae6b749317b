"""What the view keeps of a run: the newest past of its signals, reaction times, what happened, what is missing."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from rtagent.telemetry import records
from rtagent.telemetry.subscribe import Message
from rtagent.telemetry.watching import Watched
from rtagent.units import second
from rtagent.view.history import History
from rtagent.view.reactions import Reactions
from rtagent.view.returns import ELAPSED, TERMINATED, TRUNCATED

MOST_HAPPENINGS = 1000
OF_THE_SENDER = ("run", "event", "counters")
"""Streams whose times are not those of the loop: a sender that is behind tells them first."""
COMPONENTS = ("act", "observe", "choose", "learn")
ORDERING = ("order", "wait")
"""What else is told of a run that learns its ordering."""
STEP = ("reward", "delta")
"""What of a transition is shown as a signal."""


class Happening(NamedTuple):
    """Something that is listed: its number, when it was (ns), what kind it is of, and a sentence."""

    number: int
    time: int
    kind: str
    text: str


class Signal(NamedTuple):
    """Something that can be plotted: where it is kept, what it is called, its unit, and under what it is listed."""

    table: str
    column: str
    unit: str
    group: str


class SeenRun:
    """A run, as far as it was seen."""

    def __init__(self) -> None:
        self.watched = Watched()
        self.tables: dict[str, History] = {}
        self.reactions = Reactions()
        self.happenings: deque[Happening] = deque(maxlen=MOST_HAPPENINGS)
        self.counted: Counter[str] = Counter()
        self.signals: list[Signal] = []
        self.about = 0
        """Counts how often what is told of the run as a whole has changed."""
        self.newest = 0
        """The time of the newest record of the loop, in ns."""
        self._missed_at = -second
        self.heard = 0.0
        """When something came of it last, in s of the loop."""

    @property
    def run(self) -> records.Run | None:
        """What is known of the run as a whole."""
        return self.watched.run

    @property
    def began(self) -> int:
        """The time (ns) from which the page counts."""
        return self.run.time_ns if self.run is not None else 0

    def take(self, message: Message) -> None:
        """Keep a record."""
        self.watched.take(message)
        if message.stream not in OF_THE_SENDER:
            self.newest = max(self.newest, message.record.time_ns)
        if message.missed:
            self._note_missed(message.record.time_ns)
        keep = getattr(self, f"_{message.stream}", None)
        if keep is not None:
            keep(message.record)

    # What is kept of each stream

    def _run(self, run: records.Run) -> None:
        self.about += 1
        if run.ended:
            self._note(self.newest, "run", f"the run ended: {run.ended}")

    def _sample(self, sample: records.Sample) -> None:
        values = dict(_numbers(sample.values))
        units = self._units(sample.device)
        signals = [
            Signal(f"sample/{sample.device}", name, units.get(name.split("[")[0], ""), sample.device)
            for name in values
        ]
        self._add(sample.time_ns, signals, list(values.values()))

    def _units(self, device: str) -> dict[str, str]:
        about = self.run.devices.get(device) if self.run is not None else None
        return {name: each.unit for name, each in about.sensors.items()} if about is not None else {}

    def _action(self, action: records.Action) -> None:
        self._add(action.time_ns, [Signal("action", "action", "", "agent")], [action.action])

    def _transition(self, step: records.Transition) -> None:
        self._add(
            step.complete_at_ns,
            [Signal("transition", name, "", "agent") for name in STEP],
            [step.reward, step.delta],
        )
        if self.run is not None:
            columns = [*self.run.state, ELAPSED, TERMINATED, TRUNCATED]
            values = [*step.next_state, step.elapsed_ns, step.terminated, step.truncated]
            self._row("states", columns, step.complete_at_ns, values)

    def _prediction(self, prediction: records.Prediction) -> None:
        names = [str(place) for place in range(len(prediction.values))]
        self._row("prediction", names, prediction.about_ns, prediction.values)

    def _components(self, took: records.Components) -> None:
        columns = COMPONENTS if took.order is None else COMPONENTS + ORDERING
        times = [getattr(took, name) for name in columns]
        values = [None if time is None else time / 1000 for time in times]
        self.about += self._row("components", columns, took.time_ns, values)

    def _reaction(self, reaction: records.Reaction) -> None:
        self.reactions.add(reaction)

    def _episode(self, episode: records.Episode) -> None:
        self.counted["missed reactions"] += episode.missed_reactions
        reward = "unknown" if episode.total_reward is None else f"{episode.total_reward:.4g}"
        self._note(
            episode.time_ns, "episode", f"episode {episode.episode} ended: reward {reward}, {episode.steps} steps"
        )

    def _stimulus(self, stimulus: records.Stimulus) -> None:
        self._note(stimulus.happened_ns, "stimulus", stimulus.kind)

    def _event(self, event: records.Event) -> None:
        self._note(event.time_ns, event.name, event.text)

    def _fault(self, fault: records.Fault) -> None:
        self._note(fault.time_ns, "fault", f"{fault.source}: {fault.message}")

    # How it is kept

    def _note_missed(self, time: int) -> None:
        """List that something is missing, once a second: how much of which stream, the streams' table says."""
        if time - self._missed_at >= second:
            self._missed_at = time
            self._note(time, "missed", "records are missing here: see Streams")

    def _note(self, time: int, kind: str, text: str) -> None:
        self.counted[kind] += 1
        self.happenings.append(
            Happening(self.happenings[-1].number + 1 if self.happenings else 1, time, kind, text)
        )

    def _add(self, time: int, signals: Sequence[Signal], values: Sequence[Any]) -> None:
        if self._row(signals[0].table, [signal.column for signal in signals], time, values):
            known = {(signal.table, signal.column) for signal in self.signals}
            self.signals += [signal for signal in signals if (signal.table, signal.column) not in known]
            self.about += 1

    def _row(self, table: str, columns: Sequence[str], time: int, values: Sequence[Any]) -> bool:
        """Add a row; return whether its table is new, or begins again since its columns are others now."""
        history = self.tables.get(table)
        is_new = history is None or len(history.columns) != len(columns)
        if history is None or is_new:
            history = self.tables[table] = History(columns)
        history.add(time, values)
        return is_new


def _numbers(values: Any) -> Iterator[tuple[str, float]]:
    """Yield every number of a sample, those of arrays as name[place]."""
    for name, value in values.items():
        if not isinstance(value, list):
            yield name, value
            continue
        for place, each in _flat(value):
            yield f"{name}[{','.join(map(str, place))}]", each


def _flat(value: Any) -> Iterator[tuple[tuple[int, ...], float]]:
    if not isinstance(value, list):
        yield (), value
        return
    for place, each in enumerate(value):
        for inner, number in _flat(each):
            yield (place, *inner), number
