"""The emulator: the unmodified dynamixel-sdk as its client, its times on the wire, and what it costs idle."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import dynamixel_sdk as sdk
import serial
from _harness import Row

from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.emulated.robots import ROBOTS
from rtagent_drivers.dynamixel.models import MODELS
from rtagent_drivers.dynamixel.packets import Request, Span
from rtagent_drivers.dynamixel.protocol2 import PROTOCOL2
from rtagent_drivers.dynamixel.timing import transaction

PTY = "rtagent_drivers.dynamixel.emulated.pty"
ROBOT = {1: "bento", 2: "mini_bento"}
IDS = range(1, 6)
READINGS = 300
TRANSACTIONS = 200
IDLE = 3.0
"""An idle emulator is watched for so long (s)."""


@contextmanager
def emulated(robot: str, *arguments: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Give the port of an emulated robot, and its process."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", PTY, robot, "--link", str(Path(folder) / "bus"), *arguments]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            yield process.stdout.readline().strip(), process
            process.terminate()


def sdk_operations() -> Iterator[Row]:
    """Yield how many of the operations that the SDK knows fail against the emulator, with true timing."""
    for protocol, robot in ROBOT.items():
        with emulated(robot, "--timing", "true") as (port, _):
            client = Client(port, protocol)
            failed = [name for name, works in OPERATIONS[protocol].items() if not works(client)]
            client.port.closePort()
        told = f": {', '.join(failed)}" if failed else ""
        yield Row(
            f"{protocol}.0: SDK operations of {len(OPERATIONS[protocol])} that fail{told}", len(failed), "", reach=0
        )


def bus_times() -> Iterator[Row]:
    """Yield how long group reads of five servos take over a pty, times what they take on a true line."""
    for case in CASES:
        arguments = ["--timing", "true", "--baud", f"{case.baud}baud", "--return-delay", f"{case.delay}us"]
        with emulated(ROBOT[case.protocol], *arguments) as (port, _):
            took, on_the_wire = _transactions(port, case)
        name = f"{case.protocol}.0 {case.name}, {case.baud / 1e6:g} Mbaud, return delay {case.delay} µs"
        yield Row(f"{name}: on the wire", on_the_wire / 1e6, "ms")
        yield Row(f"{name}: emulated, times as long", took / on_the_wire, "", reach=1.1)


def idling() -> Iterator[Row]:
    """Yield what share of a processor an emulator takes while nobody asks it anything."""
    for robot in ROBOT.values():
        with emulated(robot, "--timing", "true") as (port, process):
            Client(port, 1).port.closePort()
            time.sleep(0.1)
            before, began = _busy(process.pid), time.monotonic()
            time.sleep(IDLE)
            share = (_busy(process.pid) - before) / (time.monotonic() - began)
        yield Row(f"{robot}: an idle emulator's share of a processor", share * 100, "%", reach=1)


class Case(NamedTuple):
    """A way of reading five servos; `delay` is their return delay (µs)."""

    protocol: int
    name: str
    baud: int
    delay: int


CASES = (
    Case(1, "bulk read", 1_000_000, 0),
    Case(1, "bulk read", 1_000_000, 500),
    Case(1, "bulk read", 57_600, 0),
    Case(2, "sync read", 1_000_000, 0),
    Case(2, "sync read", 1_000_000, 500),
    Case(2, "fast sync read", 1_000_000, 500),
)


class Client:
    """The SDK on a port; its packet handler's methods with the port given already."""

    def __init__(self, port: str, protocol: int) -> None:
        self.port, self.handler = sdk.PortHandler(port), sdk.PacketHandler(float(protocol))
        self.port.openPort()
        self.port.setBaudRate(1_000_000)
        self.protocol = protocol
        robot = ROBOTS[ROBOT[protocol]][protocol]
        self.numbers = {joint.id: MODELS[joint.model].number for joint in robot}
        self.led = 25 if protocol == 1 else 65

    def __getattr__(self, name: str) -> Any:
        """Return a method of the packet handler."""
        method = getattr(self.handler, name)
        return lambda *arguments: method(self.port, *arguments)


Works = Callable[[Client], bool]
OK = (sdk.COMM_SUCCESS, 0)


def _ping(client: Client) -> bool:
    return all(client.ping(servo) == (number, *OK) for servo, number in client.numbers.items())


def _ping_nobody(client: Client) -> bool:
    return client.ping(9)[1] == sdk.COMM_RX_TIMEOUT


def _broadcast_ping(client: Client) -> bool:
    found, result = client.broadcastPing()
    return result == sdk.COMM_SUCCESS and {servo: told[0] for servo, told in found.items()} == client.numbers


def _write_and_read(client: Client) -> bool:
    written = [client.write1ByteTxRx(servo, client.led, 1) for servo in IDS]
    return written == [OK] * 5 and _leds(client) == [1] * 5


def _read_often(client: Client) -> bool:
    return all(client.readTxRx(1 + turn % 5, 30, 20)[1:] == OK for turn in range(READINGS))


def _register_and_act(client: Client) -> bool:
    waits = client.regWriteTxRx(1, client.led, 1, [0]) == OK and client.read1ByteTxRx(1, client.led)[0] == 1
    return waits and client.action(sdk.BROADCAST_ID) == sdk.COMM_SUCCESS and _leds(client)[0] == 0


def _refuse(client: Client) -> bool:
    return client.write1ByteTxRx(1, client.led, 9) == (sdk.COMM_SUCCESS, 8 if client.protocol == 1 else 4)


def _sync_write(client: Client) -> bool:
    group = sdk.GroupSyncWrite(client.port, client.handler, client.led, 1)
    added = all(group.addParam(servo, [servo % 2]) for servo in IDS)
    return added and group.txPacket() == sdk.COMM_SUCCESS and _leds(client) == [1, 0, 1, 0, 1]


def _bulk_write(client: Client) -> bool:
    group = sdk.GroupBulkWrite(client.port, client.handler)
    added = group.addParam(1, client.led, 1, [0]) and group.addParam(2, 112, 4, [7, 0, 0, 0])
    written = added and group.txPacket() == sdk.COMM_SUCCESS
    return bool(written and _leds(client)[0] == 0 and client.read4ByteTxRx(2, 112)[0] == 7)


def _sync_read(client: Client) -> bool:
    return _reads(client, sdk.GroupSyncRead(client.port, client.handler, 112, 8), "txRxPacket", ())


def _fast_sync_read(client: Client) -> bool:
    return _reads(client, sdk.GroupSyncRead(client.port, client.handler, 112, 8), "fastSyncRead", ())


def _bulk_read(client: Client) -> bool:
    return _reads(client, sdk.GroupBulkRead(client.port, client.handler), "txRxPacket", (112, 8))


def _fast_bulk_read(client: Client) -> bool:
    return _reads(client, sdk.GroupBulkRead(client.port, client.handler), "fastBulkRead", (112, 8))


def _reads(client: Client, group: Any, way: str, span: tuple[int, ...]) -> bool:
    """Say whether a group read tells the same as reading each servo by itself."""
    added = all(group.addParam(servo, *span) for servo in IDS)
    read = added and getattr(group, way)() == sdk.COMM_SUCCESS
    singly = [client.read4ByteTxRx(servo, 116)[0] for servo in IDS]
    return bool(read and [group.getData(servo, 116, 4) for servo in IDS] == singly)


def _reboot(client: Client) -> bool:
    rebooted = client.reboot(3) == OK
    ends = time.monotonic() + 5.0
    while client.ping(3)[1:] != OK and time.monotonic() < ends:
        pass
    return rebooted and client.read1ByteTxRx(3, client.led) == (0, *OK)


def _factory_reset(client: Client) -> bool:
    return client.factoryReset(4, 2) == OK


def _leds(client: Client) -> list[int]:
    return [client.read1ByteTxRx(servo, client.led)[0] for servo in IDS]


BOTH: Mapping[str, Works] = {
    "ping": _ping,
    "ping of nobody": _ping_nobody,
    "write and read": _write_and_read,
    f"{READINGS} reads": _read_often,
    "registered write and action": _register_and_act,
    "refusal": _refuse,
    "sync write": _sync_write,
}
OPERATIONS: Mapping[int, Mapping[str, Works]] = {
    1: BOTH,  # its bulk read of protocol 1.0 raises TypeError
    2: {
        **BOTH,
        "broadcast ping": _broadcast_ping,
        "bulk write": _bulk_write,
        "sync read": _sync_read,
        "fast sync read": _fast_sync_read,
        "bulk read": _bulk_read,
        "fast bulk read": _fast_bulk_read,
        "reboot": _reboot,
        "factory reset": _factory_reset,
    },
}


def _transactions(port: str, case: Case) -> tuple[float, float]:
    """Return how long (ns) a transaction takes, the median of many, and how long it takes on a true line."""
    request, answers = _request(case), 1 if "fast" in case.name else 5
    data, decoder, times = codec(case.protocol).request(request), codec(case.protocol).status_decoder(), []
    with serial.Serial(port, case.baud, timeout=1.0) as line:
        for _ in range(TRANSACTIONS):
            found = length = 0
            began = time.monotonic_ns()
            line.write(data)
            while found < answers:
                heard = os.read(line.fileno(), 4096)
                found, length = found + len(decoder.feed(heard)), length + len(heard)
            times.append(time.monotonic_ns() - began)
    lengths = [length // answers] * answers
    return median(times), transaction(len(data), lengths, case.baud, case.delay * 1000)


def _request(case: Case) -> Request:
    spans = [Span(servo, *((36, 8) if case.protocol == 1 else (126, 21))) for servo in IDS]
    return PROTOCOL2.fast_sync_read(spans) if "fast" in case.name else codec(case.protocol).group_read(spans)


def _busy(pid: int) -> float:
    """Return how many seconds a process has had a processor."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
