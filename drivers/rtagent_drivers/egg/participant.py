"""A person who presses a button so that a moving joint stops as close to an egg as possible, without touching it.

What is known of such people, and what the model takes from it:

- *They anticipate.* The motion is seen from its beginning and is the same each time, so a press can be timed to
  come with the joint (Slater-Hammel 1960, the transit reaction). Anticipated presses scatter about what was
  aimed at. In the published example of OSARI, where a bar that fills for 800 ms is to be stopped at a line (He
  and others 2022, Behavior Research Methods 54; the file OSARI_raw_OSARI_2020_Aug_25_1336.txt), 143 go trials
  of one person ended 0.6 ms after the line on average, with a standard deviation of 25 ms. The model: a normal
  distribution of the standard deviation `spread`, without a bias of its own. That people's lie between 20 and
  50 ms is an assumption.
- *Or they react* to seeing the joint pass some mark, so chosen that their mean reaction (some 213 ms: Woods and
  others 2015, Frontiers in Human Neuroscience 9:131) is made up for. Simple reactions are distributed as the sum
  of a normal and an exponential part (Hohle 1965, Journal of Experimental Psychology 69); how large these are,
  `reaction_spread` and `reaction_tail`, is an assumption.
- *They leave a margin of time that fits their own scatter*, nearly as large as would gain most (Hudson, Maloney
  and Landy 2008, PLoS Computational Biology 4(7)); of time, as who stops a moving target near a goal does at any
  speed (Aguilar-Lleyda, Tubau and López-Moliner 2018, Journal of Vision 18). Where more is to be gained ever
  closer to losing all, as here, they come closer than would be best (Ota, Shinya and Kudo 2015, Frontiers in
  Computational Neuroscience 9:88), which practice does not change (2016, Scientific Reports 6). `caution` is
  which part of the best margin they leave.
- *They learn from the end that they see* (de la Malla, López-Moliner and Brenner 2012, Journal of Vision
  12(10): delays are adapted to where the end is seen), correcting a fixed share of the last error in the next
  attempt (van Beers 2012, PLoS ONE 7(11)): `adaptation`. The sources agree in no one number for a task as this.
  With button presses people were found to follow what they had planned rather than the last error
  (López-Moliner and others 2019, Scientific Reports 9), which would be 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import ClassVar, Literal

from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.units import Duration, ms
from rtagent_drivers.fake import CLOSED_SETTINGS

Strategy = Literal["anticipating", "reacting", "live"]
NORMAL = NormalDist()
HALVINGS = 60
MOST_DEVIATIONS = 10.0


@dataclass(frozen=True)
class Participant:
    """What a person is like; see the sources of this module.

    `strategy` is how they time a press; "live": nobody is modelled, and the button is pressed from outside. Times
    are in ns. `lag` is what they expect, at first, to pass between their press and the standstill of the joint.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    strategy: Strategy = "anticipating"
    spread: Duration = 30 * ms
    reaction_spread: Duration = 20 * ms
    reaction_tail: Duration = 40 * ms
    caution: float = 1.0
    adaptation: float = 0.2
    lag: Duration = 0

    def __post_init__(self) -> None:
        if not (self.spread > 0 and self.reaction_spread > 0 and self.reaction_tail >= 0):
            raise SpecError("participant: spread and reaction_spread are above 0, and reaction_tail is 0 or more.")
        if not (self.caution >= 0.0 and 0.0 <= self.adaptation <= 1.0 and self.lag >= 0):
            raise SpecError("participant: caution and lag are 0 or more, and adaptation is from 0 to 1.")

    @property
    def deviation(self) -> float:
        """The standard deviation (ns) of their presses about what they aim at."""
        if self.strategy == "reacting":
            return float((self.reaction_spread**2 + self.reaction_tail**2) ** 0.5)
        return float(self.spread)

    def margin(self, arrival: float) -> float:
        """Return how long (ns) before it meets the egg they want the joint to stand; it takes `arrival` until then.

        What is gained grows with the way that the joint has gone, and is lost where the egg breaks.
        """
        return self.caution * self.deviation * best_deviations(self.deviation / arrival)

    def error(self, rng: Generator) -> float:
        """Draw how much later (ns) than aimed at a press comes."""
        if self.strategy == "reacting":
            late = rng.normal(0.0, self.reaction_spread) + rng.exponential(self.reaction_tail)
            return float(late - self.reaction_tail)
        return float(rng.normal(0.0, self.spread))


def best_deviations(scatter: float) -> float:
    """Return the best margin in standard deviations; `scatter` is one of them, in parts of the whole way's time.

    The expected gain of a margin of z deviations, (1 - scatter z) Φ(z) - scatter φ(z), is greatest where
    φ(z) / Φ(z) = scatter; at least 0.
    """
    low, high = 0.0, MOST_DEVIATIONS
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if NORMAL.pdf(middle) / NORMAL.cdf(middle) > scatter:
            low = middle
        else:
            high = middle
    return low


class Person:
    """A participant with what they have learned so far: the `lag` (ns) that they reckon with."""

    def __init__(self, participant: Participant) -> None:
        self.participant, self.lag = participant, float(participant.lag)

    def lead(self, arrival: float) -> float:
        """Return how long (ns) before the joint would meet the egg they mean to press; it takes `arrival`."""
        return self.participant.margin(arrival) + self.lag

    def saw(self, beyond: float, arrival: float) -> None:
        """See the joint at rest, `beyond` the egg by so much of its way in ns (before it: negative)."""
        self.lag += self.participant.adaptation * (beyond + self.participant.margin(arrival))
