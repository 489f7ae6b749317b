"""What `rtagent devices` finds of Dynamixel servos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from serial.tools.list_ports import comports

from rtagent.finding import Finding, Search
from rtagent.units import describe, us
from rtagent_drivers.dynamixel.scan import Found, calling, mend, scan

ADAPTERS = (0x0403, 0x2F5D)
"""USB vendors of adapters for servos: FTDI (U2D2, USB2Dynamixel), ROBOTIS. Others may be anything."""

LONG_DELAY = 100 * us


async def probe(port: str, search: Search) -> Sequence[Finding]:
    """Return the servos that answer at `port`, with what is wrong with each."""
    if not search.named and not _is_for_servos(port):
        return [Finding("servos", f"not looked for; if there are some: rtagent devices --port {port}")]
    servos = await scan(port, search.bauds, search.ids)
    if not servos:
        return [_none(search)]
    if search.mend:
        servos = [await _mended(port, servo) for servo in servos]
    return [finding for servo in servos for finding in _findings(port, servo)]


def _is_for_servos(port: str) -> bool:
    return any(each.device == port and each.vid in ADAPTERS for each in comports())


def _none(search: Search) -> Finding:
    rates = ", ".join(map(str, search.bauds))
    problem = f"no servo answers at {rates} bit/s, in protocol 1.0 or 2.0."
    cure = (
        "switch the servos' power on, look at their cables, and try further rates: --bauds 115200,2000000,3000000."
    )
    return Finding("servos", "none").but(True, problem, cure)


async def _mended(port: str, servo: Found) -> Found:
    async with calling(port, servo.baud, servo.protocol, 1) as bus:
        return await mend(bus, servo)


def _findings(port: str, servo: Found) -> Sequence[Finding]:
    """Return a finding for a servo, and one more for each further problem."""
    names = " or ".join(model.name for model in servo.models) or (
        f"unknown model {servo.number}" if servo.number else "did not tell its model"
    )
    torque = {None: "", True: ", torque on", False: ", torque off"}[servo.torque]
    value = (
        f"{names}, firmware {servo.firmware}, protocol {servo.protocol}.0 at {servo.baud} bit/s,"
        f" return delay {describe(servo.return_delay)}{torque}"
    )
    found = Finding(f"servo {servo.servo}", value)
    problems = [complaint.partition(": ") for complaint in servo.complaints]
    wrong = [(f"it {problem}.", cure) for problem, _, cure in problems] + _delay(port, servo) + _unknown(servo)
    if not wrong:
        return [found]
    further = [Finding(found.name, "", *each) for each in wrong[1:]]
    return [replace(found, problem=wrong[0][0], cure=wrong[0][1]), *further]


def _delay(port: str, servo: Found) -> list[tuple[str, str]]:
    if servo.return_delay <= LONG_DELAY:
        return []
    first = "" if servo.torque is False else "support the arm, switch its torque off, then "
    problem = f"each of its answers is {describe(servo.return_delay)} late, by its return delay."
    return [(problem, f"{first}rtagent devices --port {port} --ids {servo.servo} --mend sets it to 0.")]


def _unknown(servo: Found) -> list[tuple[str, str]]:
    if servo.models:
        return []
    if not servo.number:
        return [("it answered, but not when asked for its model.", "try again; then look at its cable.")]
    return [("its model is not known here.", "use servos of a known model (see docs/scenarios.md).")]
