"""An emulated bus on a pseudo-terminal, in a process of its own.

    python -m rtagent_drivers.dynamixel.emulated.pty bento --link ./bento

It prints the name of the link once programs can open it, and takes orders on its standard input (see control.py).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from rtagent.clock import RealClock
from rtagent.errors import SpecError, did_you_mean
from rtagent.units import BAUD, TIME
from rtagent_drivers.dynamixel.emulated.bus import EmulatedBus
from rtagent_drivers.dynamixel.emulated.control import USAGE, obey, read_fault, read_joints
from rtagent_drivers.dynamixel.emulated.robots import ROBOTS, Joint
from rtagent_drivers.emulation.command import add_options, emulate, log_to, say
from rtagent_drivers.emulation.process import Emulator, Way
from rtagent_drivers.emulation.terminal import Terminal

FAULTS = """\
kinds of faults: silent, corrupt, truncated, late, noise (with a probability); babble, unplug; overload, overheat,
voltage, blocked. All take servo (an id; 0: all), begin and duration, such as "2s".
orders on the standard input, one a line:
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Emulate a robot's servos until a signal comes; return the exit code."""
    return emulate(_parser().parse_args(arguments), _emulate)


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
    with log_to(given.log) as log:
        bus = EmulatedBus(joints, protocol, now, timing=given.timing, faults=faults, log=log)
        way = Way(given.timing, given.linger)
        Emulator(bus, partial(obey, bus), terminal, way).run(lambda: say(str(given.link)))


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
    add_options(parser)
    parser.add_argument("--protocol", type=int, choices=(1, 2), help="which firmware the servos have")
    parser.add_argument("--baud", type=BAUD.parse, default=1_000_000, help="at what they listen, such as 57600baud")
    parser.add_argument("--return-delay", type=TIME.parse, default=0, help="from the factory it is 500us")
    parser.add_argument("--timing", type=_truth, default=False, help="true: bytes take as long as on a line")
    parser.add_argument("--joints", metavar="JSON", help="emulate these instead: name, id, model, start, body, ...")
    return parser


def _truth(text: str) -> bool:
    if text not in ("true", "false"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither true nor false")
    return text == "true"


if __name__ == "__main__":
    sys.exit(main())
