"""Draw reaction_time.svg: reaction time against the cost of learning, standard and reactive, virtual clock."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt

from rtagent import clock
from rtagent.scenario import assemble, load

HERE = Path(__file__).parent
SCENARIO = HERE.parent.parent / "scenarios" / "stopping.toml"
DELAYS_MS = (50, 100, 250, 500)
STYLES = {"standard": {"facecolor": "0.82", "hatch": "///"}, "reactive": {"facecolor": "0.45"}}


def reaction_times(preset: str, delay_ms: int) -> list[float]:
    """Return the reaction times (ms) of the last ten episodes of 30 trials."""
    settings = ("run.clock=virtual", "run.trials=30", "run.episodes=20")
    overrides = (*settings, f"schedule.preset={preset}", f"schedule.learn_delay={delay_ms}ms")
    scenario = load(SCENARIO, overrides)
    result = clock.run(assemble(scenario).run(), "virtual")
    late = [episode for episode in result.episodes if episode.episode >= 10]
    return [reaction.time / 1e6 for episode in late for reaction in episode.reactions.reactions]


def draw() -> None:
    """Draw one box for each preset and delay."""
    figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
    for place, (preset, style) in enumerate(STYLES.items()):
        boxes = axes.boxplot(
            [reaction_times(preset, delay) for delay in DELAYS_MS],
            positions=[3 * each + place for each in range(len(DELAYS_MS))],
            widths=0.7, whis=(0, 100), patch_artist=True, medianprops={"color": "black", "linewidth": 2},
        )  # fmt: skip
        for box in boxes["boxes"]:
            box.set(edgecolor="black", **style)
        axes.plot([], [], marker="s", linestyle="", markersize=10, color=style["facecolor"], label=preset)
    axes.set_xticks([3 * each + 0.5 for each in range(len(DELAYS_MS))], [f"{delay} ms" for delay in DELAYS_MS])
    axes.set_xlabel("time that learning takes, for each step")
    axes.set_ylabel("reaction time (ms)")
    axes.legend(title="order", frameon=False, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(HERE / "reaction_time.svg", metadata={"Date": None})


if __name__ == "__main__":
    draw()
