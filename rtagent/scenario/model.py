"""The tables of a scenario file, as data: every key, its type, its default and what it means."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema, field_validator, model_validator

from rtagent.errors import did_you_mean
from rtagent.events import Event
from rtagent.features.inputs import Traced
from rtagent.features.normalise import Outside
from rtagent.learn import Full, When, Where
from rtagent.ordering import Ordering
from rtagent.schedule import PRESETS, Overrun, Wait
from rtagent.units import TIME, Duration, ms, us


class Table(BaseModel):
    """A table: keys that it does not know are errors."""

    model_config = ConfigDict(extra="forbid")


class RunTable(Table):
    """How much is run, under which clock, from which seed."""

    clock: Literal["real", "virtual"] = Field("real", description="the clock of the run")
    fake: Literal["", "wire", "process"] = Field(
        "", description="fakes in place of hardware: emulated on the wire, or in the process"
    )
    seed: int = Field(1, ge=0, description="all random streams are derived from it")
    trials: int = Field(1, ge=1, description="each trial begins with a new agent")
    episodes: int = Field(1, ge=0, description="episodes of each trial; 0: all that a device has, as a recording")
    episode_time: Duration = Field(0, description="an episode is truncated after this time; 0: never")
    episode_steps: int = Field(0, ge=0, description="an episode is truncated after so many steps; 0: never")


Listed = Literal["act", "observe", "choose", "learn"]


class ScheduleTable(Table):
    """In which order the components run, and how the cycle is paced."""

    preset: str | None = Field(None, description="the order by its name: " + ", ".join(PRESETS))
    order: list[Listed] | None = Field(None, description="the order as a list, in place of a preset")
    learn_delay: Duration = Field(0, description="simulated cost of learning, for each transition learned")
    period: Duration = Field(0, description="the cycle's period, on absolute deadlines; 0: as fast as it goes")
    overrun: Overrun = Field(Overrun.SKIP, description="after a late cycle: skip missed deadlines or catch up")
    observe: Wait = Field(Wait.FRESH, description="observe waits for something fresh, or takes the latest")
    observe_timeout: Duration = Field(100 * ms, description="how long observe waits, at most")
    ordering: Ordering | None = Field(None, description="how the order is learned, with the preset for that")

    @field_validator("preset")
    @classmethod
    def _known_preset(cls, name: str | None) -> str | None:
        if name is not None and name not in PRESETS:
            raise ValueError(f"there is no preset {name!r}{did_you_mean(name, list(PRESETS))}")
        return name

    @model_validator(mode="after")
    def _one_of_both(self) -> ScheduleTable:
        if (self.preset is None) == (self.order is None):
            raise ValueError("give either preset or order: one of them, not both")
        return self


class UrgentTable(Table):
    """What is urgent: a sensor, or a prediction of a demon, above or below a value."""

    signal: str = Field("", description='a sensor, as "device.sensor"')
    prediction: str = Field("", description="a demon's name")
    above: float | None = Field(None, description="urgent above this value")
    below: float | None = Field(None, description="urgent below this value")


class LearnTable(Table):
    """When, in what slices and where learning runs; what is left out is the preset's."""

    when: When | None = Field(None, description="always, or only while nothing is urgent")
    slice: Duration | None = Field(None, description="learn in slices of this length; 0: in one piece")
    where: Where | None = Field(None, description="on the event loop, or on a thread")
    queue: int = Field(1000, ge=1, description="so many transitions may wait")
    full: Full = Field(Full.BLOCK, description="then the oldest is learned at once, or the newest is shed")
    urgent: UrgentTable | None = Field(None, description="what is urgent; else the task says so")


def _as_table(value: Any) -> Any:
    """Let a cost be written as a single time."""
    return value if isinstance(value, dict) else {"low": value}


class CostTable(Table):
    """What a component costs under the virtual clock: `"20us"`, or a distribution."""

    distribution: Literal["constant", "uniform", "normal", "exponential"] = "constant"
    low: Duration = Field(0, description="the constant, the least, the mean, or the offset")
    high: Duration = Field(0, description="the most, the deviation, or the mean of the exponential")


class _OrTime:
    """Describes to editors that a table may be written as a single time."""

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return {"anyOf": [handler(schema), TIME.__get_pydantic_json_schema__(schema, handler)]}


CostValue = Annotated[CostTable, BeforeValidator(_as_table), _OrTime()]


class CostsTable(Table):
    """What the components cost under the virtual clock; `order` is the decision what comes next."""

    act: CostValue | None = None
    observe: CostValue | None = None
    choose: CostValue | None = None
    learn: CostValue | None = None
    order: CostValue | None = None


class SupervisionTable(Table):
    """How patient the runtime is with a device."""

    timeout: Duration = Field(500 * ms, description="how long calls may fail or hang before the run ends safely")
    stale_after: Duration = Field(0, description="samples older than this are marked stale; 0: never")


class CheckpointTable(Table):
    """What is kept of a run, so that it can be gone on with."""

    file: str = Field("", description="the file that holds the newest checkpoint; without one, nothing is kept")
    every: Duration = Field(0, description="another is kept so often; 0: never by time")
    episodes: int = Field(1, ge=0, description="and at the end of every so many episodes; 0: of the last one only")
    step: int = Field(0, ge=0, description="and once, after so many steps of the run; 0: never")


class StopTable(Table):
    """How a run ends."""

    drain: Duration = Field(500 * ms, description="how long learning may go on after a signal or a fault")


class WatchdogTable(Table):
    """What watches over a run with real hardware from outside."""

    timeout: Duration = Field(100 * ms, description="so long without a heartbeat of the event loop, and it acts")

    @field_validator("timeout")
    @classmethod
    def _within_reach(cls, timeout: int) -> int:
        if timeout < 10 * ms:
            raise ValueError("a loop may be woken some milliseconds late: give at least 10ms")
        return timeout


Processor = Annotated[int, Field(ge=0)]


class RealtimeTable(Table):
    """What is asked of the machine, under the real clock; what it refuses is told, and the run goes on."""

    priority: int = Field(0, ge=0, le=99, description="of SCHED_FIFO, 1 to 99; 0: the ordinary scheduling")
    processors: tuple[Processor, ...] = Field((), description="the loop runs on these only; without any, on all")
    learner_processors: tuple[Processor, ...] = Field((), description="those of a thread that learns")
    gc: Literal["default", "calm"] = Field("default", description="calm: garbage is collected in calm moments only")
    switch_interval: Duration = Field(0, description="how long a thread keeps the GIL; 0: as Python has it")
    uvloop: bool = Field(False, description="the event loop is uvloop's")
    lock_memory: bool = Field(False, description="memory that was touched is never swapped out")

    @field_validator("switch_interval")
    @classmethod
    def _microseconds(cls, interval: int) -> int:
        if interval and interval < us:
            raise ValueError("Python counts it in microseconds: give at least 1us, or 0 to leave it as it is")
        return interval


class TelemetryTable(Table):
    """Who may watch a run, and how; and whether they may interfere."""

    enabled: bool | None = Field(None, description="whether it is published; else a run under the real clock is")
    endpoint: str = Field("tcp/127.0.0.1:7447", description="the router; one of this machine is started if need be")
    listen: tuple[str, ...] = Field((), description="where a router that is started listens too")
    control: bool = Field(False, description="whether those who watch may stop it, annotate it and press buttons")
    buffer: int = Field(5000, ge=1, description="so many cycles may wait to be sent")
    user: str = Field("", description="as whom to connect")
    password_file: str = Field("", description="a file with the user's password")
    ca: str = Field("", description="the certificate of the authority that signed the router's (PEM)")
    certificate: str = Field("", description="the certificate of a router that is started (PEM)")
    key: str = Field("", description="its private key (PEM)")
    users: str = Field("", description="who may connect to it: a file with user:password on each line")

    @field_validator("endpoint", "listen")
    @classmethod
    def _endpoints(cls, given: str | tuple[str, ...]) -> str | tuple[str, ...]:
        for endpoint in (given,) if isinstance(given, str) else given:
            if not re.fullmatch(r"(tcp|tls|quic)/[^/]+:\d+([?#].*)?", endpoint):
                raise ValueError(
                    f"{endpoint!r} is no endpoint: write one as tcp/127.0.0.1:7447 or tls/0.0.0.0:7448"
                )
        return given

    @model_validator(mode="after")
    def _closed(self) -> TelemetryTable:
        open_to_others = [each for each in (self.endpoint, *self.listen) if not _is_loopback(each)]
        listening = [each for each in open_to_others if each in self.listen]
        if listening and not (self.users and self.certificate and self.key):
            raise ValueError(
                f"{listening[0]} is open to other machines: give users, certificate and key, and write tls/"
            )
        if plain := [each for each in open_to_others if each.startswith("tcp/")]:
            raise ValueError(
                f"{plain[0]} would send everything in the clear to other machines: write tls/ or quic/"
            )
        return self


def _is_loopback(endpoint: str) -> bool:
    host = endpoint.split("/", 1)[1].split("?")[0].rpartition(":")[0].strip("[]")
    return host in ("localhost", "::1") or host.startswith("127.")


class PluginTable(BaseModel):
    """A table whose further keys are the settings of the plug-in that it names."""

    model_config = ConfigDict(extra="allow")


class TypedTable(PluginTable):
    """A plug-in by its `type`."""

    type: str


class InputTable(Table):
    """What stands in front of the coder: which of the task's signals it sees, and traces of their history."""

    signals: list[str] = Field([], description='names or patterns such as "*.load"; without any, all signals')
    traces: list[Traced] = Field([], description="which signals are traced, and with which decay")
    outside: Outside = Field("clip", description="values outside their declared range are clipped or masked")
    bias: bool = Field(False, description="adds a feature that is always active, the last one")


class FeaturesTable(TypedTable):
    """A coder by its `type`, its settings, and what stands in front of it."""

    input: InputTable | None = None


class HordeTable(PluginTable):
    """A Horde beside the learner: its settings, and the features that it learns from."""

    features: FeaturesTable


class DeviceTable(PluginTable):
    """A device: its driver, the driver's settings, events made of its signals, and how it is supervised."""

    driver: str
    events: dict[str, Event] = Field(default_factory=dict)
    supervision: SupervisionTable = Field(default_factory=SupervisionTable)


def _lists_by_key(table: Any) -> Any:
    """Let keys be written as `schedule.preset` or as `"schedule.preset"`: both name one list."""
    if not isinstance(table, dict):
        return table
    lists: dict[str, Any] = {}
    for key, value in table.items():
        inner = _lists_by_key(value)
        lists |= (
            {f"{key}.{rest}": each for rest, each in inner.items()} if isinstance(value, dict) else {key: value}
        )
    return lists


def _lists_schema(depth: int) -> dict[str, Any]:
    """Describe lists by their keys to editors: in one table, or in tables within tables."""
    inner = [_lists_schema(depth - 1)] if depth else []
    kinds = [{"type": "array", "minItems": 1}, *inner]
    return {"type": "object", "additionalProperties": {"anyOf": kinds}}


DEEPEST = 6
"""Of keys such as horde.features.input.traces.0.decay."""
ListsByKey = Annotated[
    dict[str, Annotated[list[Any], Field(min_length=1)]],
    BeforeValidator(_lists_by_key),
    WithJsonSchema(_lists_schema(DEEPEST)),
]


class SweepTable(Table):
    """What `rtagent sweep` runs: every combination of the values of some keys, several times."""

    trials: int = Field(1, ge=1, description="each combination so many times, with seeds from run.seed on")
    over: ListsByKey = Field(
        default_factory=dict, description="keys of the scenario, each with the list of its values"
    )


class ScenarioModel(Table):
    """A whole scenario."""

    name: str = Field("", description="what results call it")
    description: str = Field("", description="what it is for")
    run: RunTable = Field(default_factory=RunTable)
    schedule: ScheduleTable
    learn: LearnTable = Field(default_factory=LearnTable)
    costs: CostsTable = Field(default_factory=CostsTable)
    realtime: RealtimeTable = Field(default_factory=RealtimeTable)
    devices: dict[str, DeviceTable] = Field(min_length=1)
    task: TypedTable
    features: FeaturesTable
    learner: TypedTable
    horde: HordeTable | None = None
    policy: TypedTable | None = None
    checkpoint: CheckpointTable = Field(default_factory=CheckpointTable)
    stop: StopTable = Field(default_factory=StopTable)
    watchdog: WatchdogTable = Field(default_factory=WatchdogTable)
    telemetry: TelemetryTable = Field(default_factory=TelemetryTable)
    sweep: SweepTable | None = None

    @property
    def published(self) -> bool:
        """Whether others may watch the run."""
        given = self.telemetry.enabled
        return self.run.clock == "real" if given is None else given
