"""The sorting arm as a driver's fake."""

from __future__ import annotations

from rtagent_drivers.fake import FakeDevice, Faults, Sampling
from rtagent_drivers.sorting.world import WEIGHTS, SortingWorld

RATE = 30.0


def sorting_arm(
    *,
    trials: int = 30,
    weights: tuple[float, ...] = WEIGHTS,
    wrist: bool = False,
    sampling: Sampling | None = None,
    faults: Faults | None = None,
) -> FakeDevice:
    """A simulated Bento Arm that sorts three objects by their weight, for predictions: it takes no commands."""
    return FakeDevice(SortingWorld(trials, weights, wrist=wrist), sampling or Sampling(rate=RATE), faults)
