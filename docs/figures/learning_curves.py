"""Draw learning_curves.svg: CartPole that does not wait, for all presets and several costs of learning."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from learning_load import COSTS_US, STYLES
from numpy.typing import NDArray

from rtagent import clock
from rtagent.scenario import assemble, load

HERE = Path(__file__).parent
SCENARIO = HERE.parent.parent / "scenarios" / "cartpole.toml"
DELAYS_MS = (0, 15, 30, 60)
TRIALS, EPISODES, BLOCK = 10, 60, 4
SLICES = {"interruptible": ["learn.slice=1ms"]}
"""With the preset's own of 40 µs it is drawn ten times as slowly; a step of the world is 20 ms."""

Returns = NDArray[np.float64]


def returns(preset: str, delay_ms: int) -> Returns:
    """Return the return of each episode (shape: trials, episodes)."""
    costs = [f"costs.{component}={cost}us" for component, cost in COSTS_US.items()]
    plan = ["run.clock=virtual", f"run.trials={TRIALS}", f"run.episodes={EPISODES}"]
    rules = [f"schedule.preset={preset}", f"schedule.learn_delay={delay_ms}ms", *SLICES.get(preset, [])]
    result = clock.run(assemble(load(SCENARIO, [*plan, *rules, *costs])).run(), "virtual")
    return np.reshape([episode.total_reward for episode in result.episodes], (TRIALS, EPISODES))


def line(curve: Returns) -> str:
    """Return the mean of the last fifth of the episodes, and its standard error."""
    late = curve[:, -EPISODES // 5 :].mean(axis=1)
    return f"{late.mean():5.0f} ± {late.std(ddof=1) / np.sqrt(TRIALS):.0f}"


def all_returns() -> dict[tuple[int, str], Returns]:
    """Return the returns of every delay and preset."""
    jobs = list(product(DELAYS_MS, STYLES))
    with ProcessPoolExecutor() as pool:
        found = pool.map(returns, [preset for _, preset in jobs], [delay for delay, _ in jobs])
        return dict(zip(jobs, found, strict=True))


def plot(axes: plt.Axes, preset: str, curve: Returns) -> None:
    """Draw the mean of each block of episodes, and its standard error."""
    blocks = curve.reshape(TRIALS, -1, BLOCK).mean(axis=2)
    mean, error = blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / np.sqrt(TRIALS)
    ends, style = np.arange(BLOCK, EPISODES + 1, BLOCK), STYLES[preset] | {"markevery": 3, "markersize": 5}
    axes.plot(ends, mean, label=preset, **style)
    axes.fill_between(ends, mean - error, mean + error, color=style["color"], alpha=0.12, linewidth=0)


def draw() -> None:
    """Draw a panel for each cost, with a line for each preset."""
    figure, panels = plt.subplots(1, len(DELAYS_MS), figsize=(9, 2.8), sharey=True, layout="constrained")
    for (delay, preset), curve in all_returns().items():
        print(f"{delay:3} ms {preset:14} {line(curve)}")  # noqa: T201  # what the picture cannot show exactly
        plot(panels[DELAYS_MS.index(delay)], preset, curve)
    for axes, delay in zip(panels, DELAYS_MS, strict=True):
        axes.set_title(f"learning takes {delay} ms", fontsize="medium")
        axes.set_xlabel("episode")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("steps of 20 ms balanced")
    panels[-1].legend(title="preset", frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(HERE / "learning_curves.svg", metadata={"Date": None})


if __name__ == "__main__":
    draw()
