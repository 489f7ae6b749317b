"""Which signals stand for which: of the sorting arm, and of the recordings that are known."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from rtagent.errors import SpecError


@dataclass(frozen=True)
class Layout:
    """The signal whose return is predicted, and the joints that tell of it, from the shoulder on.

    The first two of `kinds`, of the first joint, are what is seen with 2 dimensions; all of them of the first two
    joints with 8, of three with 12. `stands_in` says in words what stands in the place of something else.
    """

    target: str
    joints: tuple[str, ...]
    kinds: tuple[str, ...]
    unit: str
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    stands_in: str = ""

    def signals(self, dimensions: int) -> list[str]:
        """Return what is seen with so many dimensions."""
        if dimensions == 2:
            return [f"{self.joints[0]}_{kind}" for kind in self.kinds[:2]]
        return [f"{joint}_{kind}" for joint in self.joints[: dimensions // 4] for kind in self.kinds]

    @property
    def needed(self) -> dict[str, tuple[float, float] | None]:
        """What is needed of a recording, with the range that is declared for it, if any."""
        return {name: self.ranges.get(name.rpartition("_")[2]) for name in [self.target, *self.signals(12)]}


BENTO = Layout(
    "shoulder_position",
    ("elbow", "wrist_rotation", "wrist_flexion"),
    ("position", "load", "temperature", "velocity"),
    "rad",
)
ARMPI = Layout(
    "m6_position",
    ("m5", "m4", "m3"),
    ("position", "voltage", "temperature", "velocity"),
    "counts (1000 are 240°)",
    {
        "position": (0.0, 1000.0),
        "velocity": (-600.0, 600.0),
        "temperature": (20.0, 70.0),
        "voltage": (4500.0, 8500.0),
    },
    "it has no load: the supply's voltage at each servo, which sags under load, stands in its place, "
    "and velocities are differences of positions",
)
LAYOUTS = (BENTO, ARMPI)


def layout_of(columns: Collection[str], told: str) -> Layout:
    """Return the layout whose columns are all there; raise `SpecError` where none is."""
    for layout in LAYOUTS:
        if set(layout.needed) <= set(columns):
            return layout
    wanted = " or ".join(", ".join(layout.needed) for layout in LAYOUTS)
    raise SpecError(f"{told} lacks columns that this experiment needs: call them {wanted} (velocities are made).")
