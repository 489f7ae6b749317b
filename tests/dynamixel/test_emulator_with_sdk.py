"""The unmodified dynamixel-sdk as a client of the emulator. Its `bulkReadTx` of protocol 1.0 raises TypeError."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import dynamixel_sdk as sdk
import pytest
from wire import EmulatedArm

from rtagent_drivers.dynamixel.emulated.robots import ROBOTS
from rtagent_drivers.dynamixel.models import MODELS

pytestmark = pytest.mark.slow

IDS = range(1, 6)
OK = (sdk.COMM_SUCCESS, 0)
MIDDLE = 2048


@pytest.fixture(scope="module")
def bento(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedArm]:
    with EmulatedArm(tmp_path_factory.mktemp("bento")) as arm:
        yield arm


@pytest.fixture(scope="module")
def mini_bento(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedArm]:
    with EmulatedArm(tmp_path_factory.mktemp("mini"), "mini_bento") as arm:
        yield arm


def patiently(call: Callable[[], Any]) -> Any:
    """Call again what took longer than the SDK waits, which is 34 ms, as on a busy machine."""
    for _ in range(5):
        said = call()
        if sdk.COMM_RX_TIMEOUT not in (said if isinstance(said, tuple) else (said,)):
            break
    return said


class Client:
    """The SDK with an open port; numbers of a robot's models by id."""

    def __init__(self, arm: EmulatedArm) -> None:
        self.port, self.handler = sdk.PortHandler(arm.port), sdk.PacketHandler(float(arm.protocol))
        joints = ROBOTS[arm.robot][arm.protocol]
        self.numbers = {joint.id: MODELS[joint.model].number for joint in joints}
        assert self.port.openPort()
        assert self.port.setBaudRate(1_000_000)

    def __getattr__(self, name: str) -> Any:
        """Return a method of the packet handler, the port given already."""
        method = getattr(self.handler, name)
        return lambda *arguments: patiently(lambda: method(self.port, *arguments))


@pytest.fixture
def old(bento: EmulatedArm) -> Iterator[Client]:
    client = Client(bento)
    yield client
    client.port.closePort()


@pytest.fixture
def new(mini_bento: EmulatedArm) -> Iterator[Client]:
    client = Client(mini_bento)
    yield client
    client.port.closePort()


def wait_for(client: Client, servo: int, address: int, goal: int) -> None:
    """Wait until a servo's position is where it was to go."""
    read = client.read2ByteTxRx if address == 36 else client.read4ByteTxRx
    ends = time.monotonic() + 10.0
    while abs(read(servo, address)[0] - goal) > 2:
        assert time.monotonic() < ends, f"servo {servo} does not get there"
        time.sleep(0.02)


def test_ping(old: Client, new: Client) -> None:
    for client in (old, new):
        found = {servo: client.ping(servo) for servo in IDS}
        assert found == {servo: (number, *OK) for servo, number in client.numbers.items()}
        assert client.ping(6)[1] == sdk.COMM_RX_TIMEOUT


@pytest.mark.slow
def test_broadcast_ping(new: Client) -> None:
    found, result = new.broadcastPing()  # it waits for 800 ms in any case
    assert result == sdk.COMM_SUCCESS
    assert {servo: number for servo, (number, _) in found.items()} == new.numbers


def test_protocol_1_reads_and_writes(old: Client) -> None:
    assert old.write2ByteTxRx(1, 32, 600) == OK
    assert old.write2ByteTxRx(1, 30, 2300) == OK
    assert old.read2ByteTxRx(1, 30) == (2300, *OK)
    wait_for(old, 1, 36, 2300)
    assert old.write1ByteTxRx(1, 24, 0) == OK
    data, result, error = old.readTxRx(1, 34, 10)
    assert (result, error, len(data), data[8:]) == (*OK, 10, [120, 25])


def test_protocol_1_refuses_as_the_sdk_understands(old: Client) -> None:
    assert old.write2ByteTxRx(2, 30, 4096) == (sdk.COMM_SUCCESS, 8)
    assert "Out of range" in old.handler.getRxPacketError(8)


def test_protocol_1_writes_to_all_at_once(old: Client) -> None:
    group = sdk.GroupSyncWrite(old.port, old.handler, 30, 4)
    for servo in (3, 4, 5):
        assert group.addParam(servo, [0x98, 0x08, 0x58, 0x02])
    assert group.txPacket() == sdk.COMM_SUCCESS
    for servo in (3, 4, 5):
        wait_for(old, servo, 36, 0x898)


def test_protocol_1_registers_and_acts(old: Client) -> None:
    assert old.regWriteTxRx(1, 30, 2, [0x60, 0x08]) == OK
    assert old.read2ByteTxRx(1, 30)[0] != 0x860
    assert old.action(sdk.BROADCAST_ID) == sdk.COMM_SUCCESS
    assert old.read2ByteTxRx(1, 30) == (0x860, *OK)


def test_protocol_2_reads_and_writes(new: Client) -> None:
    assert new.write4ByteTxRx(1, 112, 300) == OK
    assert new.write1ByteTxRx(1, 64, 1) == OK
    assert new.write4ByteTxRx(1, 116, 2300) == OK
    wait_for(new, 1, 132, 2300)
    assert new.write1ByteTxRx(1, 64, 0) == OK
    assert new.write4ByteTxRx(1, 116, 5000) == (sdk.COMM_SUCCESS, 6)
    assert "limit" in new.handler.getRxPacketError(6).lower()


@pytest.mark.parametrize("way", ["sync", "fast sync", "bulk", "fast bulk"])
def test_protocol_2_reads_groups(new: Client, way: str) -> None:
    bulk = "bulk" in way
    group = (sdk.GroupBulkRead if bulk else sdk.GroupSyncRead)(new.port, new.handler, *(() if bulk else (116, 15)))
    for servo in IDS:
        assert group.addParam(servo, 116, 10 + servo) if bulk else group.addParam(servo)
    ask = {"fast sync": "fastSyncRead", "fast bulk": "fastBulkRead"}.get(way, "txRxPacket")
    assert patiently(getattr(group, ask)) == sdk.COMM_SUCCESS
    assert group.isAvailable(5, 116, 4)
    singly = {servo: new.read4ByteTxRx(servo, 116)[0] for servo in (1, 3, 5)}
    assert {servo: group.getData(servo, 116, 4) for servo in (1, 3, 5)} == singly


def test_protocol_2_writes_groups(new: Client) -> None:
    sync = sdk.GroupSyncWrite(new.port, new.handler, 65, 1)
    for servo in IDS:
        assert sync.addParam(servo, [1])
    assert sync.txPacket() == sdk.COMM_SUCCESS
    assert [new.read1ByteTxRx(servo, 65)[0] for servo in IDS] == [1] * 5
    bulk = sdk.GroupBulkWrite(new.port, new.handler)
    assert bulk.addParam(1, 65, 1, [0])
    assert bulk.addParam(2, 112, 4, [7, 0, 0, 0])
    assert bulk.txPacket() == sdk.COMM_SUCCESS
    assert (new.read1ByteTxRx(1, 65)[0], new.read4ByteTxRx(2, 112)[0]) == (0, 7)


def test_protocol_2_starts_anew(new: Client, mini_bento: EmulatedArm) -> None:
    mini_bento.fault("overload", 4)
    assert new.read1ByteTxRx(4, 70) == (0x20, sdk.COMM_SUCCESS, 0x80)
    assert new.reboot(4)[0] == sdk.COMM_SUCCESS
    ends = time.monotonic() + 10.0
    while new.ping(4) != (new.numbers[4], *OK):
        assert time.monotonic() < ends
    assert new.read1ByteTxRx(4, 70) == (0, *OK)
    assert new.clearMultiTurn(4) == OK
    assert new.factoryReset(4, 2) == OK
