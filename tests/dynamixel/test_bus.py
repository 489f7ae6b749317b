from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest
from scripted import ScriptedServos

from rtagent.errors import DeviceError, DisconnectedError
from rtagent.units import ms
from rtagent_drivers.dynamixel.bus import Bus
from rtagent_drivers.dynamixel.codecs import CODECS
from rtagent_drivers.dynamixel.orders import questions
from rtagent_drivers.dynamixel.packets import Instruction, Request, Span
from rtagent_drivers.dynamixel.polling import Roster, Round

MODELS = {1: dict.fromkeys((1, 2, 3), "MX-28"), 2: dict.fromkeys((1, 2, 3), "XL330-M288")}
STATE = {1: (36, 8), 2: (126, 21)}


@pytest.fixture(params=[1, 2], ids=["1.0", "2.0"])
def protocol(request: pytest.FixtureRequest) -> int:
    number: int = request.param
    return number


@asynccontextmanager
async def bus_of(servos: ScriptedServos, patience: int = 5 * ms) -> AsyncIterator[Bus]:
    bus = Bus(servos.codec, servos.port, 1_000_000, patience)
    bus.return_delay = 0
    await bus.open()
    try:
        yield bus
    finally:
        await bus.close()


def spans(protocol: int, *servos: int) -> list[Span]:
    return [Span(servo, *STATE[protocol]) for servo in servos]


def asked(protocol: int, *servos: int) -> tuple[Request, dict[int, int]]:
    with_length = dict.fromkeys(servos, STATE[protocol][1])
    return CODECS[protocol].group_read(spans(protocol, *servos)), with_length


async def rounds_of(bus: Bus, protocol: int, heard: list[Round], servos: tuple[int, ...] = (1, 2, 3)) -> None:
    bus.poll(Roster(bus.codec, spans(protocol, *servos)), 1 * ms, heard.append, lambda error: None)


async def until(condition: Callable[[list[Round]], bool], heard: list[Round]) -> None:
    async with asyncio.timeout(5):
        while not condition(heard):  # noqa: ASYNC110  # what is waited for sends no event
            await asyncio.sleep(0.001)


async def test_answers_come_by_servo_and_a_missing_one_does_not_cost_the_others(protocol: int) -> None:
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos) as bus:
            assert (await bus.transact(*asked(protocol, 1, 2, 3))).keys() == {1, 2, 3}
            servos.tamper = lambda servo, answer: b"" if servo == 3 else answer
            assert (await bus.transact(*asked(protocol, 1, 2, 3))).keys() == {1, 2}
            assert bus.counters["answers_missing"] == 1


async def test_what_is_missing_is_asked_for_again_a_bounded_number_of_times(protocol: int) -> None:
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos) as bus:
            servos.tamper = lambda servo, answer: answer if len(servos.heard) > 2 else b""
            assert (await bus.transact(*asked(protocol, 1), retries=5)).keys() == {1}
            assert len(servos.heard) == 3
            servos.tamper = lambda servo, answer: b""
            assert await bus.transact(*asked(protocol, 1), retries=2) == {}
            assert len(servos.heard) == 6


async def test_after_garbage_it_finds_the_next_answer(protocol: int) -> None:
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos) as bus:
            servos.tamper = lambda servo, answer: b"\xff\xff\xfd\x00\x55" + answer[:-1] + b"\xff" + answer
            assert (await bus.transact(*asked(protocol, 1), retries=1)).keys() == {1}
            servos.tamper = lambda servo, answer: answer
            assert (await bus.transact(*asked(protocol, 1, 2))).keys() == {1, 2}
            assert bus.counters["bytes_skipped"] > 0


async def test_a_late_answer_is_not_taken_for_another(protocol: int) -> None:
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos) as bus:
            late: list[bytes] = []
            servos.tamper = lambda servo, answer: late.append(answer) or b""  # type: ignore[func-returns-value]
            assert await bus.transact(*asked(protocol, 1)) == {}
            servos.tamper = lambda servo, answer: late.pop(0) + answer if late else answer
            assert (await bus.transact(*asked(protocol, 2))).keys() == {2}
            assert bus.counters["answers_unexpected"] == 1


async def test_one_silent_servo_is_left_out_and_taken_in_again(protocol: int) -> None:
    heard: list[Round] = []
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos) as bus:
            servos.tamper = lambda servo, answer: b"" if servo == 1 else answer
            await rounds_of(bus, protocol, heard)
            await until(lambda rounds: len(rounds) > 20, heard)
            assert all(round_.statuses.keys() == {2, 3} for round_ in heard[-10:])
            servos.tamper = lambda servo, answer: answer
            await until(lambda rounds: rounds[-1].statuses.keys() == {1, 2, 3}, heard)


async def test_the_newest_command_takes_the_place_of_one_that_waits(protocol: int) -> None:
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos, 20 * ms) as bus:
            servos.tamper = lambda servo, answer: b""
            reading = asyncio.ensure_future(bus.transact(*asked(protocol, 1)))
            await asyncio.sleep(0)
            first = asyncio.ensure_future(bus.send("goal", servos.codec.sync_write(64, {1: b"\1"})))
            other = asyncio.ensure_future(bus.send("led", servos.codec.sync_write(65, {1: b"\1"})))
            await asyncio.sleep(0)
            second = asyncio.ensure_future(bus.send("goal", servos.codec.sync_write(64, {1: b"\0"})))
            assert await asyncio.gather(first, other, second) == [False, True, True]
            assert await reading == {}
            await bus.transact(*asked(protocol, 1))
        written = [write for request in servos.heard for write in servos.codec.writes(request)]
        assert [(write.address, write.data) for write in written] == [(65, b"\1"), (64, b"\0")]


async def test_a_command_that_waited_while_the_process_stood_still_is_not_sent(protocol: int) -> None:
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos) as bus:
            servos.tamper = lambda servo, answer: b""
            reading = asyncio.ensure_future(bus.transact(*asked(protocol, 1)))
            await asyncio.sleep(0)
            sending = asyncio.ensure_future(bus.send("goal", servos.codec.sync_write(64, {1: b"\1"})))
            await asyncio.sleep(0)
            time.sleep(0.1)  # noqa: ASYNC251  # as a process does that is stopped and goes on
            with pytest.raises(DeviceError, match="a command waited for"):
                await sending
            await reading
            await bus.send("goal", servos.codec.sync_write(64, {1: b"\2"}))
            await bus.transact(*asked(protocol, 1))
        written = [write for request in servos.heard for write in servos.codec.writes(request)]
        assert [write.data for write in written] == [b"\2"]


async def test_a_command_and_the_next_read_are_one_call_to_the_system(
    protocol: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[bytes] = []
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos) as bus:
            put = bus._put
            monkeypatch.setattr(bus, "_put", lambda data: (calls.append(data), put(data)))
            reading = asyncio.ensure_future(bus.transact(*asked(protocol, 1)))
            await asyncio.sleep(0)
            write = servos.codec.sync_write(64, {1: b"\1"})
            sending = asyncio.ensure_future(bus.send("goal", write))
            again = asyncio.ensure_future(bus.transact(*asked(protocol, 2)))
            await asyncio.gather(reading, sending, again)
    read = servos.codec.request(asked(protocol, 2)[0])
    assert calls[1:] == [servos.codec.request(write) + read]


async def test_an_emergency_overtakes_all_and_drops_commands(protocol: int) -> None:
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos, 200 * ms) as bus:
            servos.tamper = lambda servo, answer: b"" if servo == 1 else answer
            waiting = [asyncio.ensure_future(bus.transact(*asked(protocol, servo))) for servo in (1, 3)]
            command = asyncio.ensure_future(bus.send("goal", servos.codec.sync_write(64, {1: b"\1"})))
            await asyncio.sleep(0.005)
            stop = servos.codec.sync_write(64, {1: b"\0", 2: b"\0", 3: b"\0"})
            began = asyncio.get_running_loop().time()
            read = questions(servos.codec, [Span(2, 64, 1)], [])
            statuses = await bus.emergency([stop], read)
            took = asyncio.get_running_loop().time() - began
            assert statuses[2].parameters == b"\0"
            with pytest.raises(DeviceError, match="a stop overtook the command"):
                await command
            await asyncio.gather(*waiting)
        assert took < 0.2  # it did not wait for the deadline of the silent servo
        asked_of = [servos.codec.spans(request)[0].servo for request in servos.heard if request != stop]
        assert asked_of == [1, 2, 3]
        writes = [request for request in servos.heard if request.instruction == Instruction.SYNC_WRITE]
        assert writes == [stop]


async def test_a_bus_full_of_garbage_does_not_hold_an_emergency_up(protocol: int) -> None:
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos, 10_000 * ms) as bus:
            servos.tamper = lambda servo, answer: b"\x5a" * 64 if servo == 1 else answer
            waiting = asyncio.ensure_future(bus.transact(*asked(protocol, 1)))
            await asyncio.sleep(0)
            async with asyncio.timeout(5):
                statuses = await bus.emergency([], questions(servos.codec, [Span(2, 64, 1)], []))
                assert statuses.keys() == {2}
                assert await waiting == {}


async def test_when_the_line_goes_everything_that_waits_hears_of_it(protocol: int) -> None:
    lost: list[DisconnectedError] = []
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos, 10_000 * ms) as bus:
            bus.poll(Roster(bus.codec, spans(protocol, 1)), 1 * ms, lambda heard: None, lost.append)
            servos.tamper = lambda servo, answer: b""
            waiting = [asyncio.ensure_future(bus.transact(*asked(protocol, servo))) for servo in (2, 3)]
            await asyncio.sleep(0.005)
            servos.unplug()
            for each in waiting:
                with pytest.raises(DisconnectedError, match=r"has gone .*: plug its adapter in again"):
                    await each
            assert len(lost) == 1
            with pytest.raises(DisconnectedError, match="open it first"):
                await bus.send("goal", servos.codec.sync_write(64, {1: b"\1"}))


async def test_rounds_keep_their_pace(protocol: int) -> None:
    heard: list[Round] = []
    with ScriptedServos(protocol, MODELS[protocol]) as servos:
        async with bus_of(servos) as bus:
            bus.poll(Roster(bus.codec, spans(protocol, 1)), 10 * ms, heard.append, lambda error: None)
            await until(lambda rounds: len(rounds) > 8, heard)
    began = heard[0].sent
    assert all((round_.sent - began) >= 10 * ms * number - 1000 for number, round_ in enumerate(heard))
