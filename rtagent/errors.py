"""Every error that rtagent raises on purpose; each message is a sentence that says what to do."""

from __future__ import annotations

from difflib import get_close_matches


class RtagentError(Exception):
    """The base of all errors raised on purpose."""


class SpecError(RtagentError, ValueError):
    """A value does not fit its spec."""


class UnitError(RtagentError, ValueError):
    """A quantity was written without a unit, or with one of another kind."""


class ScheduleError(RtagentError, ValueError):
    """An order of components that cannot work."""


class ClockError(RtagentError, RuntimeError):
    """Something that the clock of this run cannot do."""


class RunStuckError(ClockError):
    """A virtual run in which nothing would ever happen again."""


class DeviceError(RtagentError):
    """A device failed; the runtime tries again within the device's retry budget."""


class DisconnectedError(DeviceError):
    """A device went away; the runtime opens it anew within its retry budget."""


class LimitError(DeviceError):
    """A limit was reached beyond which moving is not safe; the run is stopped at once, nothing is tried again."""


class StoppedError(RtagentError):
    """The run is stopped: nothing moves any more."""


class CheckpointError(RtagentError, ValueError):
    """A file that is no checkpoint that can be gone on with; nothing of it was taken."""


class BaselineError(RtagentError, ValueError):
    """A file or a revision that nothing can be compared with."""


class ReplayError(RtagentError, ValueError):
    """A recording that cannot be replayed."""


class PluginError(RtagentError, LookupError):
    """No plug-in of that name, or one that cannot be loaded."""


class ScenarioError(RtagentError, ValueError):
    """All that is wrong with a scenario, one sentence a problem, each with its file and line."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class SweepError(RtagentError):
    """A sweep that cannot be done, or in which cells could not be measured; what was measured is kept."""


class UndecidedError(RtagentError):
    """What was measured does not say whether a limit is kept."""


def did_you_mean(name: str, known: list[str]) -> str:
    """Return the end of a sentence: a hint at the nearest of the known names, or at all of them."""
    near = get_close_matches(name, known, n=1)
    return f": did you mean {near[0]!r}?" if near else f": use one of {', '.join(known)}." if known else "."
