"""A Horde: demons that learn from the same transitions, in groups of those that can share a trace."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rtagent.errors import SpecError, did_you_mean
from rtagent.experience import FeatureVector, FloatArray, State, Transition
from rtagent.learning.cumulants import Cumulants, Signal, Within
from rtagent.learning.demons import Demon, Demons, Method
from rtagent.learning.groups import DemonGroup
from rtagent.learning.returns import PredictionErrors
from rtagent.learning.shared_trace import Precision
from rtagent.memory import claim
from rtagent.saving import Saved
from rtagent.specs import Spec

if TYPE_CHECKING:
    Declared = Demons | Demon
else:
    Declared = Demons  # what a scenario can write


class Horde:
    """Many predictions about the signals of the state (thesis, section 2.3.2), learned in slices.

    `size` and `active` are those of the features, `state` the signals; `demons` declares what is predicted.
    `alpha` (of all active features together, unless `divide_alpha` is false) and `lambda_` are those of every set
    that does not say otherwise. The returns of `measured` demons, evenly spread over those that predict
    values, are waited for and compared with what was predicted; with `rupee` their projected errors are estimated
    too. Weights are float32 or float64. `actions` is how many the agent has, where that is known: a policy that
    demons ask about is then checked.
    A signal outside its declared range is learned from as the end of the range, and counted in `clipped`; raises
    `SpecError` for one that is not a number, before anything is learned.
    """

    needs_next_action = False

    def __init__(
        self,
        *,
        size: int,
        state: Mapping[str, Spec],
        active: int = 1,
        actions: int | None = None,
        demons: tuple[Declared, ...] = (Demons(),),
        alpha: float = 0.1,
        divide_alpha: bool = True,
        lambda_: float = 0.9,
        precision: Precision = "float32",
        measured: int = 20,
        rupee: bool = False,
    ) -> None:
        self._signals = _Signals(state)
        usual = Method(alpha=alpha, divide_alpha=divide_alpha, lambda_=lambda_)
        self.demons = _expanded(demons, state, usual)
        if actions is not None:
            _check_policies(self.demons, actions)
        _claim(self.demons, size, precision)
        cumulants = [self._signals.place(demon) for demon in self.demons]
        self.places = _grouped(self.demons)
        """The places of the demons of each group."""
        self.groups: list[DemonGroup] = []
        measured_places = _measured(self.demons, measured)
        for places in self.places:
            members = [self.demons[place] for place in places]
            table = Cumulants([cumulants[place] for place in places], precision)
            watched = [number for number, place in enumerate(places) if place in measured_places]
            below = [group for group in self.groups if group.set in members[0].on]
            self.groups.append(DemonGroup(members, table, size, active, precision, below, watched, rupee))
        self._by_name = {
            self.demons[place].name: (group, number)
            for group, places in zip(self.groups, self.places, strict=True)
            for number, place in enumerate(places)
        }

    def __len__(self) -> int:
        return len(self.demons)

    @property
    def names(self) -> list[str]:
        """The names of the demons, in their order."""
        return [demon.name for demon in self.demons]

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values lay outside their range, by signal."""
        return self._signals.clipped

    @property
    def newest(self) -> FloatArray:
        """The newest predictions, shape (demons,): of the last state that was learned about."""
        return self._gathered(group.learned.estimate for group in self.groups)

    def predict(self, features: FeatureVector) -> FloatArray:
        """Return the prediction of every demon for a state with these features, shape (demons,)."""
        return self._gathered(group.predict(features) for group in self.groups)

    def prediction(self, name: str, features: FeatureVector) -> float:
        """Return one prediction for a state with these features; raise `SpecError` where no demon has that name."""
        if name not in self._by_name:
            raise SpecError(f"there is no demon {name!r}{did_you_mean(name, list(self._by_name))}")
        group, place = self._by_name[name]
        return group.predict_one(features, place)

    def update(self, transition: Transition) -> float:
        """Learn from a transition; return the root mean square of the demons' deltas."""
        updating = self.updating(transition)
        while True:
            try:
                next(updating)
            except StopIteration as done:
                return float(done.value)

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        """Do what `update` does, in slices."""
        signals = self._signals(transition)
        for group in self.groups:
            group.begin(transition)
        for group in self.groups:
            yield from group.updating(transition, signals)
        square = sum(float(group.learned.delta @ group.learned.delta) for group in self.groups)
        return math.sqrt(square / len(self))

    def errors(self) -> dict[str, PredictionErrors]:
        """Return the errors of the measured demons, by their names."""
        return {name: errors for group in self.groups for name, errors in group.errors()}

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        for group in self.groups:
            group.learned.inherit(place, like)

    def save(self) -> Saved:
        """Return the state of every group; not to be called in the middle of an update."""
        groups = {str(number): group.save() for number, group in enumerate(self.groups)}
        return groups | {"clipped": dict(self.clipped)}

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        for number, group in enumerate(self.groups):
            group.restore(saved[str(number)])
        self._signals.clipped = dict(saved["clipped"])

    def _gathered(self, parts: Iterable[Any]) -> FloatArray:
        gathered = np.empty(len(self))
        for places, part in zip(self.places, parts, strict=True):
            gathered[places] = part
        return gathered


class _Signals:
    """What cumulants are taken of: the signals of the next state, and the values of those that are functions."""

    def __init__(self, state: Mapping[str, Spec]) -> None:
        self._names = list(state)
        plain = [spec if not spec.shape else Spec(low=0.0, high=0.0) for spec in state.values()]
        self._low, self._high = np.array([[spec.low, spec.high] for spec in plain], dtype=float).reshape(-1, 2).T
        self._functions: list[Any] = []
        self.clipped = dict.fromkeys(self._names, 0)

    def place(self, demon: Demon) -> Signal | Within:
        """Return a demon's cumulant as a place in what a call returns."""
        if isinstance(demon.cumulant, Signal | Within):
            return demon.cumulant
        self._functions.append((demon.name, demon.cumulant))
        return Signal(len(self._names) + len(self._functions) - 1)

    def __call__(self, transition: Transition) -> FloatArray:
        """Return the values, clipped to their ranges; raise `SpecError` for one that is not finite."""
        values = self._clipped(transition.next_state)
        if not self._functions:
            return values
        more = [float(function(transition)) for _, function in self._functions]
        for (name, _), value in zip(self._functions, more, strict=True):
            if not math.isfinite(value):
                raise SpecError(f"the cumulant of demon {name!r} is {value}: nothing is learned from it.")
        return np.concatenate((values, more))

    def _clipped(self, state: State) -> FloatArray:
        values = np.asarray(state, dtype=np.float64)
        if values.shape != self._low.shape:
            raise SpecError(
                f"the state has shape {values.shape}, not one number for each of {len(self._low)} signals."
            )
        clipped: FloatArray = np.minimum(np.maximum(values, self._low), self._high)
        if not np.array_equal(values, clipped):
            for name, value, inside in zip(self._names, values.tolist(), clipped.tolist(), strict=True):
                if math.isnan(value):
                    raise SpecError(f"signal {name!r} is not a number (NaN): nothing is learned from it.")
                self.clipped[name] += value != inside
        return clipped


def _expanded(declared: Sequence[Declared], state: Mapping[str, Spec], usual: Method) -> list[Demon]:
    demons: list[Demon] = []
    for each in declared:
        demons += [each] if isinstance(each, Demon) else each.expand(state, usual)
    if not demons:
        raise SpecError("demons is empty: declare at least one set of them.")
    claim(1000 * len(demons), "the descriptions of the demons")
    names = [demon.name for demon in demons]
    if len(set(names)) < len(names):
        double = next(name for number, name in enumerate(names) if name in names[:number])
        raise SpecError(f"two demons are called {double!r}: give one of their sets a name.")
    return demons


def _check_policies(demons: Sequence[Demon], actions: int) -> None:
    for demon in demons:
        if demon.policy is None:
            continue
        if not actions:
            raise SpecError(
                f"demon {demon.name!r} asks about a policy, and this run only predicts, so that nothing is done: "
                "leave its policy out, or let the agent control and put the demons into [horde]."
            )
        if isinstance(demon.policy, Sequence) and len(demon.policy) != actions:
            raise SpecError(
                f"demon {demon.name!r} asks about the policy {list(demon.policy)}: "
                f"give the probability of each of the {actions} actions."
            )


def _claim(demons: Sequence[Demon], size: int, precision: Precision) -> None:
    count = sum(demon.method.algorithm == "true_online_td" for demon in demons)
    if count:
        claim(
            size * count * np.dtype(precision).itemsize, f"the weights of {count:,} demons over {size:,} features"
        )


def _measured(demons: Sequence[Demon], count: int) -> set[int]:
    """Return the places of so many demons, evenly spread: of those that predict values, if there are any."""
    values = [place for place, demon in enumerate(demons) if not isinstance(demon.cumulant, Within)]
    places = np.array(values or range(len(demons)))
    return set(places[np.linspace(0, len(places) - 1, min(count, len(places))).astype(int)].tolist())


def _grouped(demons: Sequence[Demon]) -> list[list[int]]:
    """Return the places of the demons that share a trace; sets come after those that they are built on."""
    groups: dict[object, list[int]] = {}
    for place, demon in enumerate(demons):
        groups.setdefault(demon.shared, []).append(place)
    ordered: list[list[int]] = []
    waiting = list(groups.values())
    while waiting:
        missing = {demons[places[0]].set for places in waiting}
        ready = [places for places in waiting if not missing & set(demons[places[0]].on)]
        if not ready:
            stuck = demons[waiting[0][0]]
            raise SpecError(f"the demons {stuck.set!r} are built on themselves: on names {', '.join(stuck.on)}.")
        ordered += ready
        waiting = [places for places in waiting if places not in ready]
    return ordered
