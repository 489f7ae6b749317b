"""An emulated board on a pseudo-terminal, in a process of its own.

    python -m rtagent_drivers.arduino.emulated.pty handi --link ./hand

It prints the name of the link once programs can open it, and takes orders on its standard input.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rtagent.clock import RealClock
from rtagent.errors import SpecError
from rtagent.units import BAUD, FREQUENCY, TIME
from rtagent_drivers.arduino.bodies import BODIES, Body
from rtagent_drivers.arduino.emulated.board import GLOVE, HAND, EmulatedBoard, Make
from rtagent_drivers.arduino.emulated.faults import Fault
from rtagent_drivers.arduino.emulated.openings import WatchedTerminal
from rtagent_drivers.arduino.layouts import LAYOUTS
from rtagent_drivers.emulation.command import Log, add_options, emulate, log_to, say
from rtagent_drivers.emulation.process import Emulator, Way
from rtagent_drivers.emulation.terminal import Terminal

USAGE = """\
kinds of faults: silent, corrupt, cut, noise (with a probability); jitter (with a delay); deaf; unplug. All take
begin and duration, such as "2s".
orders on the standard input, one a line:
{"do": "fault", "kind": "unplug", "duration": "2s"}   a fault, from now on
{"do": "mend"}                                        the end of all faults
{"do": "reset"}                                       as by the board's button
{"do": "set", "pin": "A3", "reading": 512}            what is read at a pin, or of a field of a legacy line
{"do": "tell"}                                        print the time, as JSON
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Emulate a board until a signal comes; return the exit code."""
    return emulate(_parser().parse_args(arguments), _emulate)


def handi(arguments: Sequence[str]) -> int:
    """The HANDi Hand's board: 15 channels and six servos; or, with --format handi, its older sketch."""
    return main(["handi", *arguments])


def glovi(arguments: Sequence[str]) -> int:
    """The GLOVi Glove's board: six bend sensors; or, with --format glovi or glovi_binary, its older sketches."""
    return main(["glovi", *arguments])


def _emulate(given: argparse.Namespace) -> None:
    terminal = WatchedTerminal(given.link)
    with log_to(given.log) as log:
        now = RealClock.now()
        body = BODIES[given.body or ("hand" if given.board == "handi" else "glove")]()
        body.begin(given.since or now, np.random.default_rng(given.seed))
        basics = _make(given), body, now, partial(_line_baud, terminal), log
        board = ResetByOpening(*basics, terminal.was_opened) if given.auto_reset else EmulatedBoard(*basics)
        way = Way(linger=given.linger)
        Emulator(board, partial(obey, board), terminal, way).run(lambda: say(str(given.link)))


class ResetByOpening(EmulatedBoard):
    """A board that starts anew when its port is opened, as most do; `opened` returns whether that has happened."""

    def __init__(
        self,
        make: Make,
        body: Body,
        now: int,
        line_baud: Callable[[], int],
        log: Log | None,
        opened: Callable[[], bool],
    ) -> None:
        super().__init__(make, body, now, line_baud, log)
        self._opened = opened

    def receive(self, now: int, data: bytes, baud: int) -> None:
        """Take what the host says, unless it has just opened the port."""
        self._look(now)
        super().receive(now, data, baud)

    def take(self, now: int) -> bytes:
        """Return what has reached the host, which may have just opened the port."""
        self._look(now)
        return super().take(now)

    def _look(self, now: int) -> None:
        if self._opened():
            self.reset(now)


def obey(board: EmulatedBoard, now: int, line: str) -> dict[str, Any] | None:
    """Do what a line says; raise `SpecError` where it says nothing that can be done."""
    try:
        order = json.loads(line)
        do = order.pop("do")
        if do == "fault":
            board.trouble.faults.append(_fault(order, board.age(now)))
        elif do == "mend":
            board.trouble.faults.clear()
        elif do == "reset":
            board.reset(now)
        elif do == "set":
            board.overridden[order["pin"]] = int(order["reading"])
        elif do == "tell":
            return {"time": now}
        else:
            raise SpecError(f"there is nothing called {do!r} to be done: see `rtagent emulate handi --help`.")
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise SpecError(f"{line!r} is no order ({error}): see `rtagent emulate handi --help`.") from error
    return None


def read_fault(text: str) -> Fault:
    """Return a fault from a JSON object; raise `SpecError`."""
    try:
        return _fault(json.loads(text), 0)
    except (ValueError, TypeError) as error:
        raise SpecError(f"{text!r} is no fault ({error}): see `rtagent emulate handi --help`.") from error


def _fault(told: dict[str, Any], since: int) -> Fault:
    times: dict[str, Any] = {
        name: TIME.parse(told[name]) for name in ("begin", "duration", "delay") if name in told
    }
    fault = Fault(**{**told, **times})
    return replace(fault, begin=fault.begin + since)


def _line_baud(terminal: Terminal) -> int:
    return 0 if terminal.fileno < 0 else terminal.baud()


def _make(given: argparse.Namespace) -> Make:
    usual = HAND if given.board == "handi" else GLOVE
    layout = LAYOUTS[given.format]
    if layout.legacy:
        usual = Make(given.format, layout.channels, layout.servos, layout.rate, layout.baud)
    return replace(
        usual,
        channels=given.channels.split(",") if given.channels else usual.channels,
        servos=[int(pin) for pin in given.servos.split(",") if pin] if given.servos is not None else usual.servos,
        rate=given.rate or usual.rate,
        baud=given.baud or usual.baud,
        drift=given.drift,
        boot=given.boot,
        faults=[read_fault(text) for text in given.fault],
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rtagent emulate",
        description="Emulate an Arduino board on a pseudo-terminal.",
        epilog=USAGE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("board", choices=["handi", "glovi"])
    add_options(parser)
    parser.add_argument("--format", choices=list(LAYOUTS), default="rtagent", help="which sketch it runs")
    parser.add_argument("--body", choices=list(BODIES), help="what is on its pins")
    parser.add_argument("--channels", metavar="PINS", help="the pins of its channels, such as 2,A2,A3")
    parser.add_argument("--servos", metavar="PINS", help="the pins of its servos, such as 3,5")
    parser.add_argument("--rate", type=FREQUENCY.parse, help="how often it measures until it is told, such as 70Hz")
    parser.add_argument("--baud", type=BAUD.parse, help="at what its sketch speaks, such as 1Mbaud")
    parser.add_argument("--drift", type=float, default=0.0, help="by how much its clock is fast, such as 0.001")
    parser.add_argument("--boot", type=TIME.parse, default=0, help="how long it takes to start, such as 1s")
    parser.add_argument("--auto-reset", action="store_true", help="opening the port resets it")
    parser.add_argument("--seed", type=int, default=0, help="of what happens on its pins")
    parser.add_argument("--since", type=int, default=0, metavar="NS", help="when that began (monotonic)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
