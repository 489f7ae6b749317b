"""Draw learning_load.svg: reaction time against the cost of learning, for all presets, virtual clock."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt

from rtagent import clock
from rtagent.scenario import assemble, load

HERE = Path(__file__).parent
SCENARIO = HERE.parent.parent / "scenarios" / "stopping.toml"
DELAYS_MS = (0, 10, 25, 50, 100, 200, 300, 400, 500)
COSTS_US = {"observe": 10, "choose": 7, "act": 3}
"""What the components cost under the real clock: without them two of the presets would react in no time at all."""

STYLES = {
    "standard": {"color": "0.0", "linestyle": "-", "marker": "s"},
    "reactive": {"color": "0.45", "linestyle": "-", "marker": "o"},
    "deferred": {"color": "0.0", "linestyle": ":", "marker": "x", "markersize": 9},
    "interruptible": {"color": "0.0", "linestyle": "--", "marker": "^"},
    "background": {"color": "0.6", "linestyle": "-.", "marker": "D"},
}


STEADY = ("interruptible", "background")
"""Their reactions hardly differ, and their cycles are many: a few episodes are enough."""


def median(preset: str, delay_ms: int) -> float:
    """Return the median reaction time (ms) of 5 trials, or of 4 episodes where reactions hardly differ."""
    steady = preset in STEADY or not delay_ms
    plan = ["run.trials=1", "run.episodes=4"] if steady else ["run.trials=5"]
    settings = ["run.clock=virtual", f"schedule.preset={preset}", *plan]
    costs = [f"costs.{component}={cost}us" for component, cost in COSTS_US.items()]
    scenario = load(SCENARIO, [*settings, *costs, f"schedule.learn_delay={delay_ms}ms"])
    return clock.run(assemble(scenario).run(), "virtual").reaction_time.median / 1e6


def draw() -> None:
    """Draw one line for each preset."""
    figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
    for preset, style in STYLES.items():
        axes.plot(DELAYS_MS, [median(preset, delay) for delay in DELAYS_MS], label=preset, **style)
    axes.set_yscale("log")
    axes.set_xlabel("time that learning takes, for each step (ms)")
    axes.set_ylabel("median reaction time (ms)")
    axes.legend(title="preset", frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(HERE / "learning_load.svg", metadata={"Date": None})


if __name__ == "__main__":
    draw()
