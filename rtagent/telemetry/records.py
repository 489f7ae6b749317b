"""The records of a run, one kind for each stream; JSON by their types, and the schemas of it.

Every record has `sequence`, which counts those of its stream from 0 without a gap, and `time_ns`, when it was so,
on the clock of the run (monotonic, or virtual). `Run.epoch_ns` plus `time_ns` is the time since 1970.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

Number = int | float | bool
SignalValue = Number | list[Any]
"""A number, or an array as nested lists."""


class Record(msgspec.Struct, kw_only=True, frozen=True):
    """What every record has: its place in its stream, and its time in ns."""

    sequence: int
    time_ns: int


class Signal(msgspec.Struct, frozen=True):
    """What a signal may be: its type, shape, unit and range (None: no end)."""

    dtype: str
    shape: list[int]
    unit: str
    low: float | None
    high: float | None


class DeviceSignals(msgspec.Struct, frozen=True):
    """The signals of a device, by name; `rate` in Hz (0: as of now; None: only when something happens)."""

    sensors: dict[str, Signal]
    actuators: dict[str, Signal]
    rate: float | None


class DemonAbout(msgspec.Struct, frozen=True):
    """What a demon predicts: the discounted sum of `signal`, or, with `low` and `high`, how often it is within.

    `signal` is "" for a cumulant that is a function, `gamma` None where it depends on the state; it is for each
    step, or each second (`per`). `normalised`: (1 - gamma) times the sum is predicted.
    """

    name: str
    signal: str
    low: float | None
    high: float | None
    gamma: float | None
    per: str
    normalised: bool


class Run(Record, kw_only=True, frozen=True):
    """A run as a whole. The newest record counts: `demons` are known with the first trial.

    `control` says whether it takes commands, `buttons` which devices can be pressed by one; `ended` how it ended
    ("": it goes on).
    """

    agent: str
    run: str
    epoch_ns: int
    clock: str
    seed: int
    scenario: dict[str, Any]
    machine: dict[str, Any]
    versions: dict[str, str]
    devices: dict[str, DeviceSignals]
    state: list[str]
    actions: list[str]
    demons: list[DemonAbout]
    buttons: list[str]
    control: bool
    ended: str = ""


class Sample(Record, kw_only=True, frozen=True):
    """What came of a device: its values, when the world was so, when they arrived, and the device's own number."""

    device: str
    number: int
    values: dict[str, SignalValue]
    world_time_ns: int
    arrival_time_ns: int
    time_source: str


class Observation(Record, kw_only=True, frozen=True):
    """What the agent observed: the newest sample of each device, by its number, and the devices that are stale."""

    samples: dict[str, int]
    stale: list[str]


class Choice(Record, kw_only=True, frozen=True):
    """An action was chosen: `learned` transitions of the trial had been learned, and `pieces` of the next one."""

    action: int
    probability: float
    learned: int
    pieces: int


class Action(Record, kw_only=True, frozen=True):
    """An action that was taken: with which probability it was chosen, when, and what the devices really took.

    `time_ns` is when act ended. `chosen_ns` is None for one that was taken again without a choice.
    """

    action: int
    name: str
    probability: float
    chosen_ns: int | None
    began_ns: int
    sent: dict[str, dict[str, SignalValue]]


class Transition(Record, kw_only=True, frozen=True):
    """A transition that was learned, at `time_ns`; `delta` is the learner's error.

    What is not finite is None.
    """

    action: int | None
    next_action: int | None
    probability: float
    reward: float | None
    elapsed_ns: int
    terminated: bool
    truncated: bool
    state: list[float | None]
    next_state: list[float | None]
    complete_at_ns: int
    delta: float | None


class Prediction(Record, kw_only=True, frozen=True):
    """The predictions of all demons, in the order of `Run.demons`, about the next state of a learned transition.

    `about_ns` is when that state was observed; what is not finite is None.
    """

    about_ns: int
    values: list[float | None]


class Components(Record, kw_only=True, frozen=True):
    """How long each component ran, in ns, since the record before: None where it did not.

    `order` is deciding which comes next, where that is learned, and `wait` is waiting.
    """

    act: int | None = None
    observe: int | None = None
    choose: int | None = None
    learn: int | None = None
    order: int | None = None
    wait: int | None = None


class Reaction(Record, kw_only=True, frozen=True):
    """A stimulus got its first reaction: the three parts of the reaction time, and their sum, in ns."""

    kind: str
    stimulus_ns: int
    sensing: int
    deciding: int
    acting: int
    reaction: int


class Stimulus(Record, kw_only=True, frozen=True):
    """A stimulus, when an observation first contained it; `happened_ns` is its true time."""

    kind: str
    happened_ns: int
    time_source: str


class Event(Record, kw_only=True, frozen=True):
    """Something to remember: an annotation of a person's, an episode that began, the end of a trial, a command.

    `name` is annotation, episode (with its `trial` and `episode`), learned (the digest of what an agent has
    learned when its `trial` ends), stop, press or recording.
    """

    name: str
    text: str
    trial: int | None = None
    episode: int | None = None


class Fault(Record, kw_only=True, frozen=True):
    """Something failed: where, and what, in a sentence."""

    source: str
    message: str


class Counters(Record, kw_only=True, frozen=True):
    """What was counted so far, once a second, of the run, its devices (as `DEVICE.NAME`) and its telemetry.

    `lost.STREAM` records of a stream found the buffer full: their sequence numbers are missing, everywhere.
    `not_recorded` are missing in the recording alone, as after a full disk. `buffered` is how many bytes were
    waiting to be sent.
    """

    values: dict[str, int]


class Episode(Record, kw_only=True, frozen=True):
    """An episode that ended."""

    trial: int
    episode: int
    began_ns: int
    ended_ns: int
    total_reward: float | None
    steps: int
    truncated: bool
    reactions: list[int]
    responses: list[int]
    missed_reactions: int
    missed_responses: int
    anticipated: int


STREAMS: Mapping[str, type[Record]] = {
    "run": Run,
    "sample": Sample,
    "observation": Observation,
    "choice": Choice,
    "action": Action,
    "transition": Transition,
    "prediction": Prediction,
    "components": Components,
    "reaction": Reaction,
    "stimulus": Stimulus,
    "event": Event,
    "fault": Fault,
    "counters": Counters,
    "episode": Episode,
}
"""The kind of record of each stream. A stream `sample` is one of all devices."""

STREAM_OF: Mapping[type[Record], str] = {kind: stream for stream, kind in STREAMS.items()}


def schema_name(stream: str) -> str:
    """Return what the encoding of a stream's messages calls their schema."""
    return f"rtagent.{STREAMS[stream].__name__}"


def schema(stream: str) -> dict[str, Any]:
    """Return the JSON schema of a stream's messages, self-contained, with an object at its root."""
    made: dict[str, Any] = msgspec.json.schema(STREAMS[stream])
    definitions = made.pop("$defs")
    root: dict[str, Any] = definitions.pop(made["$ref"].rsplit("/", 1)[1])
    return root | ({"$defs": definitions} if definitions else {})


def schemas() -> Sequence[tuple[str, bytes]]:
    """Return the schema of every stream, as JSON."""
    return [(stream, msgspec.json.encode(schema(stream))) for stream in STREAMS]
