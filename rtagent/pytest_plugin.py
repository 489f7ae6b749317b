"""The plugin for pytest: `pytest --rtagent-latency`, the fixture and the marker `rtagent_latency`.

It is loaded by every pytest where rtagent is installed, so it imports what it needs only when it is used.
"""

from __future__ import annotations

import os
from collections.abc import Generator
from dataclasses import fields
from typing import TYPE_CHECKING

import pytest

from rtagent.errors import RtagentError, SpecError, UndecidedError, did_you_mean

if TYPE_CHECKING:
    from rtagent.latencies.fixture import Latency
    from rtagent.latencies.rounds import Rules

MARKER = "rtagent_latency"
OPTION, STRICT = "--rtagent-latency", "--rtagent-latency-strict"
LINES = pytest.StashKey[list[str]]()

NOT_MARKED = (
    f"this test measures under the real clock: mark it with @pytest.mark.{MARKER}, "
    f"so that it runs only with {OPTION}."
)
NOT_ALONE = "latency is measured by one process alone, and pytest-xdist runs several: run with -n0."


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("rtagent", "rtagent: reaction times")
    group.addoption(OPTION, action="store_true", help=f"run the tests marked {MARKER}: they measure in real time")
    group.addoption(
        STRICT, action="store_true", help="fail, in place of skipping, what the measurements do not decide"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Tell pytest of the marker."""
    config.stash[LINES] = []
    config.addinivalue_line(
        "markers",
        f"{MARKER}(rounds=10, warm_up=1, stolen=0.1, confidence=0.95, processor=None, least=10): "
        f"measures in real time; runs only with {OPTION}",
    )


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what measures in real time, unless it was asked for."""
    if item.get_closest_marker(MARKER) is not None and not item.config.getoption(OPTION):
        pytest.skip(f"measures in real time: run with {OPTION}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Skip a test whose measurements decide nothing, or fail it where that was asked for; say why either way."""
    try:
        return (yield)
    except UndecidedError as undecided:
        if item.config.getoption(STRICT):
            pytest.fail(f"undecided: {undecided}", pytrace=False)
        item.config.stash[LINES].append(f"{item.nodeid}: undecided: {undecided}")
        pytest.skip(f"undecided: {undecided}")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print what was measured, and what was not decided."""
    lines = config.stash[LINES]
    if lines:
        terminalreporter.section("rtagent latency")
        for line in lines:
            terminalreporter.line(line)


@pytest.fixture
def rtagent_latency(request: pytest.FixtureRequest) -> Latency:
    """Run scenarios and measure how long they take to react (docs/latency.md of rtagent)."""
    from rtagent.latencies.fixture import Latency
    from rtagent.latencies.rounds import Rules

    marker = request.node.get_closest_marker(MARKER)
    lines = request.config.stash[LINES]
    try:
        rules = _rules(marker) if marker is not None else Rules()
    except RtagentError as error:
        pytest.fail(str(error), pytrace=False)
    return Latency(
        rules,
        lambda: _refuse_unfit(marker is not None),
        lambda line: lines.append(line if line.startswith(" ") else f"{request.node.nodeid}: {line}"),
    )


def _rules(marker: pytest.Mark) -> Rules:
    """Return the rules that a marker gives; raise `SpecError` where it gives something else."""
    from rtagent.latencies.rounds import Rules

    known = [field.name for field in fields(Rules)]
    if marker.args:
        raise SpecError(f"the marker {MARKER} takes names only, such as rounds=20: it got {marker.args[0]!r}.")
    for name in marker.kwargs:
        if name not in known:
            raise SpecError(f"the marker {MARKER} knows no {name!r}{did_you_mean(name, known)}")
    return Rules(**marker.kwargs)


def _refuse_unfit(marked: bool) -> None:
    """Refuse to measure in real time where that was not asked for, or would say nothing."""
    if not marked:
        raise SpecError(NOT_MARKED)
    if "PYTEST_XDIST_WORKER" in os.environ:
        raise SpecError(NOT_ALONE)
