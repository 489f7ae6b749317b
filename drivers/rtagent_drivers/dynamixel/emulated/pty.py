"""An emulated bus on a pseudo-terminal, in a process of its own.

    python -m rtagent_drivers.dynamixel.emulated.pty bento --link ./bento

It prints the name of the link once programs can open it, and takes orders on its standard input (see control.py).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

from rtagent.clock import RealClock
from rtagent.errors import RtagentError, SpecError, did_you_mean
from rtagent.units import BAUD, TIME
from rtagent_drivers.dynamixel.emulated.bus import EmulatedBus, Log
from rtagent_drivers.dynamixel.emulated.control import USAGE, obey, read_fault, read_joints
from rtagent_drivers.dynamixel.emulated.process import Emulator, Way
from rtagent_drivers.dynamixel.emulated.robots import ROBOTS, Joint
from rtagent_drivers.dynamixel.emulated.terminal import Terminal

FAULTS = """\
kinds of faults: silent, corrupt, truncated, late, noise (with a probability); babble, unplug; overload, overheat,
voltage, blocked. All take servo (an id; 0: all), begin and duration, such as "2s".
orders on the standard input, one a line:
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Emulate a robot's servos until a signal comes; return the exit code."""
    given = _parser().parse_args(arguments)
    try:
        _emulate(given)
    except (RtagentError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def bento(arguments: Sequence[str]) -> int:
    """The Bento Arm: five MX servos, protocol 1.0 (or 2.0), ids 1 to 5, on a pseudo-terminal."""
    return main(["bento", *arguments])


def mini_bento(arguments: Sequence[str]) -> int:
    """The Mini-Bento: five XL330 servos, protocol 2.0, ids 1 to 5, on a pseudo-terminal."""
    return main(["mini_bento", *arguments])


def _emulate(given: argparse.Namespace) -> None:
    terminal = Terminal(given.link)
    joints, protocol = _joints(given)
    faults = [read_fault(text) for text in given.fault]
    now = RealClock.now()
    with _log(given.log) as log, contextlib.suppress(SystemExit):
        bus = EmulatedBus(joints, protocol, now, timing=given.timing, faults=faults, log=log)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, _end)
        way = Way(given.timing, given.linger)
        Emulator(bus, partial(obey, bus), terminal, way).run(lambda: _say(str(given.link)))


def _joints(given: argparse.Namespace) -> tuple[Sequence[Joint], int]:
    """Return the servos, and their protocol; raise `SpecError` where there are none such."""
    if given.joints is not None:
        return read_joints(given.joints), given.protocol or 1
    if given.robot not in ROBOTS:
        raise SpecError(f"no robot {given.robot!r} is known{did_you_mean(given.robot, list(ROBOTS))}")
    known = ROBOTS[given.robot]
    protocol = given.protocol or next(iter(known))
    if protocol not in known:
        raise SpecError(f"{given.robot} does not speak protocol {protocol}.0: leave --protocol out.")
    return [replace(each, baud=given.baud, return_delay=given.return_delay) for each in known[protocol]], protocol


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rtagent emulate",
        description="Emulate servos on a pseudo-terminal.",
        epilog=FAULTS + USAGE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("robot", help=f"{' or '.join(ROBOTS)}, or any name with --joints")
    parser.add_argument("--link", type=Path, required=True, help="the name under which programs find the bus")
    parser.add_argument("--protocol", type=int, choices=(1, 2), help="which firmware the servos have")
    parser.add_argument("--baud", type=BAUD.parse, default=1_000_000, help="at what they listen, such as 57600baud")
    parser.add_argument("--return-delay", type=TIME.parse, default=0, help="from the factory it is 500us")
    parser.add_argument("--timing", type=_truth, default=False, help="true: bytes take as long as on a line")
    parser.add_argument("--log", type=Path, metavar="FILE", help="what happens goes there, a JSON object a line")
    parser.add_argument("--fault", action="append", default=[], metavar="JSON", help="may be repeated")
    parser.add_argument("--linger", type=TIME.parse, help="end so long after the standard input has ended")
    parser.add_argument("--joints", metavar="JSON", help="emulate these instead: name, id, model, start, body, ...")
    return parser


def _truth(text: str) -> bool:
    if text not in ("true", "false"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither true nor false")
    return text == "true"


@contextlib.contextmanager
def _log(path: Path | None) -> Iterator[Log | None]:
    """Give what writes to the log, a line at a time, so that it can be read meanwhile."""
    if path is None:
        yield None
        return
    with path.open("a", buffering=1, encoding="utf-8") as file:
        write: Callable[[str], Any] = file.write
        yield lambda what: write(json.dumps(what) + "\n")


def _end(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
