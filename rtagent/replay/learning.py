"""Learning in a replay: as far as the run had learned at each moment, or by a schedule without time."""

from __future__ import annotations

import math

from rtagent.agent import Agent
from rtagent.backlog.backlog import Update


class Learning:
    """Learns what an agent has in its queue, the oldest first; `deltas` are the learner's errors.

    What the learner raises ends learning, as in a run: `failure` says what it was.
    """

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._update: Update | None = None
        self.deltas: list[float] = []
        self.failure = ""

    def learn_until(self, transitions: int, pieces: int) -> None:
        """Learn until so many transitions are learned, as far as there are, and pieces of the next."""
        while len(self.deltas) < transitions and self._begin():
            self._finish()
        while pieces and (update := self._begin()) and update.pieces < pieces:
            if self._step(update):
                break

    def learn_all(self) -> None:
        """Learn all that waits."""
        while self._begin():
            self._finish()

    def _begin(self) -> Update | None:
        if self._update is None and self._agent.queue:
            self._update = Update(self._agent.learner, self._agent.queue.popleft(), 0, sliced=True)
        return self._update

    def _finish(self) -> None:
        while self._update is not None and not self._step(self._update):
            pass

    def _step(self, update: Update) -> bool:
        try:
            over = update.step()
        except Exception as error:  # whatever the learner raises, the run went on without learning
            self.failure = str(error)
            self._agent.keeps_transitions, self._update = False, None
            self._agent.queue.clear()
            return True
        if over:
            self._update = None
            self.deltas.append(update.delta)
        return over


def same(one: float, other: float) -> bool:
    """Say whether two errors are the same number, or both none."""
    return one == other or (math.isnan(one) and math.isnan(other))
