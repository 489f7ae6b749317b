"""What the person sees: an arm on its way to an egg as a line of text, and what is said."""

from __future__ import annotations

from rtagent.experiments.egg.attempts import Attempt
from rtagent.units import degree

WIDTH = 60
"""Characters from the start of the arm to a little beyond the egg."""

BEYOND = 1.25
"""So much of the way to the egg is shown."""

ARM, EGG, CRUSHED, TRACK = "▶", "O", "*", "·"


def line(gone: float) -> str:
    """Return the arm and the egg as `WIDTH` characters; `gone` is the arm's way, where that to the egg is 1."""
    egg = round(WIDTH / BEYOND)
    arm = min(max(round(gone * egg), 0), WIDTH - 1)
    drawn = [TRACK] * WIDTH
    drawn[egg] = CRUSHED if gone >= 1.0 else EGG
    drawn[min(arm, egg - 1) if gone < 1.0 else arm] = ARM
    return "".join(drawn)


def instructions(key: str, practice: int, others: int) -> str:
    """Return what a person is told before the first attempt."""
    return (
        "An arm swings towards an egg (O).\n"
        f"Press {key} to stop it as close to the egg as you can, without touching it.\n"
        f"There are {practice} attempts to practise, then {others} more, in which the program of the arm changes "
        "from one\nto the next without a word: at the end you see what that did. Esc ends the game.\n"
        f"Press {key} to begin.\n"
    )


def told(attempt: Attempt, number: int, of: int) -> str:
    """Return how an attempt went, without its condition."""
    return f"attempt {number} of {of}: {_how(attempt)}"


def _how(attempt: Attempt) -> str:
    if attempt.broken and attempt.pressed is None:
        return "crushed: you did not press"
    if attempt.broken:
        return f"crushed: {abs(attempt.short) / degree:.1f}° too far"
    return f"stopped {attempt.short / degree:.1f}° before the egg"
