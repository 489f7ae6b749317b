"""The back end `sdk`: the same bus, with the dynamixel-sdk at its other end in a process of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest
from wire import EmulatedArm

from rtagent.device import Device
from rtagent.errors import DisconnectedError, SpecError
from rtagent.testing import DeviceContract
from rtagent_drivers.dynamixel import sdk
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.driver import Dynamixel
from rtagent_drivers.dynamixel.packets import Instruction, Request, Span, Write
from rtagent_drivers.dynamixel.sdk import sdk_bus
from rtagent_drivers.serial_line import Line, Receiver

pytestmark = pytest.mark.slow

SPANS = {1: (36, 8), 2: (126, 21)}
LED = {1: 25, 2: 65}


@pytest.fixture(params=[1, 2], scope="module")
def bus_of(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[int, str]]:
    with EmulatedArm(tmp_path_factory.mktemp("bus"), "bento", "--protocol", str(request.param)) as arm:
        yield request.param, arm.port


@pytest.fixture(scope="module")
def bento(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedArm]:
    with EmulatedArm(tmp_path_factory.mktemp("bento")) as arm:
        yield arm


async def test_it_reads_and_writes_as_our_own_does(bus_of: tuple[int, str]) -> None:
    protocol, port = bus_of
    bus = sdk_bus(codec(protocol), port, 1_000_000)
    spans = [Span(servo, *SPANS[protocol]) for servo in range(1, 6)]
    expected = {span.servo: span.length for span in spans}
    led = bus.codec.read(Span(2, LED[protocol], 1))
    await bus.open()
    try:
        statuses = await bus.transact(bus.codec.group_read(spans), expected, retries=3)
        assert {servo: len(status.parameters) for servo, status in statuses.items()} == expected
        assert await bus.send("leds", bus.codec.sync_write(LED[protocol], {2: b"\x01", 3: b"\x01"}))
        assert (await bus.transact(led, {2: 1}, retries=3))[2].parameters == b"\x01"
        await bus.transact(bus.codec.write(Write(2, LED[protocol], b"\x00")), {2: 0}, retries=3)
        assert (await bus.transact(led, {2: 1}, retries=3))[2].parameters == b"\x00"
        ping = Request(3, Instruction.PING)
        assert 3 in await bus.transact(ping, {3: 0 if protocol == 1 else 3}, retries=3)
    finally:
        await bus.close()


class TestDriver(DeviceContract):
    """The driver keeps its contract on this back end too."""

    @pytest.fixture(autouse=True)
    def _port(self, bento: EmulatedArm) -> None:
        self._bento = bento

    def make_device(self) -> Device:
        return Dynamixel(port=self._bento.port, joints=self._bento.joints(), rate=100.0, backend="sdk")


async def test_a_servo_that_is_not_there_costs_its_own_answer_and_the_next_ones_not(
    bus_of: tuple[int, str],
) -> None:
    protocol, port = bus_of
    bus = sdk_bus(codec(protocol), port, 1_000_000)
    await bus.open()
    try:
        assert await bus.transact(bus.codec.read(Span(9, *SPANS[protocol])), {9: SPANS[protocol][1]}) == {}
        there = await bus.transact(bus.codec.read(Span(1, *SPANS[protocol])), {1: SPANS[protocol][1]}, retries=3)
        assert 1 in there
    finally:
        await bus.close()


async def test_a_port_that_goes_away_is_told(tmp_path: Path) -> None:
    told: asyncio.Future[Exception | None] = asyncio.get_running_loop().create_future()

    class Ears:
        def data_received(self, data: bytes, /) -> None:
            pass

        def connection_lost(self, error: DisconnectedError | None, /) -> None:
            told.set_result(error)

    ears: Receiver = Ears()
    with EmulatedArm(tmp_path) as arm:
        line: Line = await sdk.connect(1, arm.port, 1_000_000, ears)
    line.write(codec(1).request(Request(1, Instruction.PING)))
    try:
        assert isinstance(await asyncio.wait_for(told, 20), DisconnectedError)
        with pytest.raises(DisconnectedError, match="open it first"):
            line.write(b"")
    finally:
        await line.close()


async def test_what_cannot_be_opened_has_a_sentence() -> None:
    with pytest.raises(DisconnectedError, match="there is no port /dev/nowhere"):
        await sdk_bus(codec(1), "/dev/nowhere", 1_000_000).open()


async def test_a_rate_that_the_sdk_does_not_know_has_a_sentence(bus_of: tuple[int, str]) -> None:
    protocol, port = bus_of
    with pytest.raises(DisconnectedError, match="does not know 57142 baud"):
        await sdk_bus(codec(protocol), port, 57_142).open()


def test_without_the_sdk_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sdk, "find_spec", lambda name: None)
    with pytest.raises(SpecError, match="pip install"):
        sdk_bus(codec(1), "/dev/nowhere", 1_000_000)
