"""How the calls of a device fare, and whether its samples are usable."""

from __future__ import annotations

from rtagent.experience import Values
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import ms

FIRST_PAUSE = 1 * ms
LONGEST_PAUSE = 50 * ms


class Health:
    """How one kind of call of a device fares: since when it fails (None: it works), and when to try it again."""

    def __init__(self, timeout: int) -> None:
        self._timeout = timeout
        self.failing_since: int | None = None
        self.retry_at = 0
        self._pause = FIRST_PAUSE
        self.last_error = ""

    def failed(self, now: int, error: str, hung: bool) -> None:
        """Note a failure; a call that hung has used up the budget."""
        if self.failing_since is None:
            self.failing_since = now - (self._timeout if hung else 0)
            self._pause = FIRST_PAUSE
        self.last_error = error
        self.retry_at = now + self._pause
        self._pause = min(2 * self._pause, LONGEST_PAUSE)

    def spent(self, now: int) -> int:
        """Return how long (ns) it has been failing."""
        return 0 if self.failing_since is None else now - self.failing_since


class Validity:
    """Whether values fit a device's spec; quick for plain numbers, which most are."""

    def __init__(self, spec: DeviceSpec) -> None:
        self._sensors = spec.sensors
        sensors = spec.sensors.items()
        self._ranges = [(sensor, each.low, each.high) for sensor, each in sensors if _plain(each)]
        self._others = [(sensor, each) for sensor, each in sensors if not _plain(each)]

    def holds(self, values: Values) -> bool:
        """Say whether every sensor is there, and within its range."""
        try:
            for name, low, high in self._ranges:
                if not low <= values[name] <= high:  # NaN fails too
                    return False
            return not self._others or self._others_hold(values)
        except (KeyError, TypeError, ValueError):
            return False

    def why_not(self, values: Values) -> str:
        """Say in a sentence what is wrong with `values`."""
        for name, spec in self._sensors.items():
            problem = spec.problem(values[name]) if name in values else "it is not in the sample"
            if problem is not None:
                return f"a sample was not usable, sensor {name!r}: {problem}; expected {spec}"
        return "a sample was not usable"

    def _others_hold(self, values: Values) -> bool:
        return all(spec.problem(values[name]) is None for name, spec in self._others)


def _plain(spec: Spec) -> bool:
    return spec.shape == () and spec.dtype != "int"
