"""What moves in the grasping experiment, as functions of time: the hand that grasps, and the hand in the glove."""

from __future__ import annotations

import numpy as np

from rtagent.experience import FloatArray
from rtagent_drivers.grasping import assumed
from rtagent_drivers.grasping.session import CLOSES, FINGERS, RELEASES, THINGS, Session, Times, share


class Grasp:
    """The joints of an underactuated hand that closes around each object, and what its force sensors show."""

    def __init__(self, session: Session) -> None:
        self._session, rng = session, session.hand_rng
        joints, trials = list(assumed.JOINTS.values()), len(session)
        closed = np.array([[joint.cylinder, joint.step] for joint in joints])[:, session.stepped.astype(int)]
        drift = np.outer([joint.drifts for joint in joints], assumed.DRIFT * session.drift)
        shape = (len(joints), trials)
        moves = np.array([joint.cylinder != joint.open for joint in joints])[:, None]
        self._open = np.array([[joint.open] for joint in joints]) + drift + rng.normal(0, assumed.REST, shape)
        self._closed = np.where(moves, closed + drift + rng.normal(0, assumed.GRIP, shape), self._open)
        self._moves = {joint.moves: [each.moves == joint.moves for each in joints] for joint in joints}
        self._pressing = assumed.PRESSING * (1.0 + assumed.DRIFT * session.drift)

    def joints(self, times: Times) -> FloatArray:
        """Return where the joints are, shape (joints, n), as those of `assumed.JOINTS`: 0 to 1."""
        trial, since = self._session.at(times)
        moved = np.empty((len(assumed.JOINTS), len(times)))
        for (first, last), which in self._moves.items():
            moved[which] = _held(since, first, last)
        opened = self._open[:, trial]
        found: FloatArray = opened + (self._closed[:, trial] - opened) * moved
        return found

    def thumb_force(self, times: Times) -> FloatArray:
        """Return what the only force sensor that is pressed shows, shape (n,): 0 to 1."""
        trial, since = self._session.at(times)
        force: FloatArray = self._pressing[trial] * _held(since, 0.8, 1.0)
        return force


def _held(since: Times, first: float, last: float) -> FloatArray:
    """Return how far what moves from one part of the closing to another has gone; it opens in reverse."""
    takes = (last - first) * assumed.CLOSING
    closes = share(since, CLOSES + round(first * assumed.CLOSING), takes)
    return closes - share(since, RELEASES + round((1.0 - last) * assumed.CLOSING), takes)


class Gestures:
    """The fingers of the experimenter, who puts some down for each object while the hand holds it."""

    def __init__(self, session: Session) -> None:
        self._session, rng = session, session.glove_rng
        shape = (len(FINGERS), len(session))
        downs = np.array([[finger in thing.gesture for thing in THINGS] for finger in FINGERS])
        self._neutral = assumed.NEUTRAL + rng.normal(0.0, assumed.NEUTRAL_SPREAD, shape)
        down = assumed.DOWN + rng.normal(0.0, assumed.DOWN_SPREAD, shape)
        self._reach = np.where(downs[:, session.things], down - self._neutral, 0.0)
        self._begin = CLOSES + _after(rng, assumed.ANSWERS_AFTER, assumed.ANSWER_SPREAD, shape)
        self._end = RELEASES + _after(rng, assumed.RETURNS_AFTER, assumed.RETURN_SPREAD, shape)
        spread = np.clip(rng.normal(size=len(session)), -2.5, 2.5)
        self._takes: FloatArray = assumed.MOVING + assumed.MOVING_SPREAD * spread

    def bends(self, times: Times) -> FloatArray:
        """Return how far each finger is bent, shape (6, n), in the order of `FINGERS`: 0 to 1."""
        trial, since = self._session.at(times)
        takes = self._takes[trial]
        put_down = share(since, self._begin[:, trial], takes) - share(since, self._end[:, trial], takes)
        found: FloatArray = self._neutral[:, trial] + self._reach[:, trial] * put_down
        return found


def _after(rng: np.random.Generator, mean: int, spread: int, shape: tuple[int, int]) -> Times:
    """Return when each finger moves, shape (fingers, trials): together, but for some ms."""
    together = spread * np.clip(rng.normal(size=shape[1]), -2.5, 2.5)
    apart = assumed.APART * np.clip(rng.normal(size=shape), -2.5, 2.5)
    return np.rint(mean + together + apart).astype(np.int64)
