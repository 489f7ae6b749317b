"""The sorting arm: mechanics against statics and energy, heat against its law, trials, and what its servos tell."""

from __future__ import annotations

import subprocess
import sys
from math import exp, pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.clock import ClockName
from rtagent.errors import SpecError
from rtagent.experiments.streams import named
from rtagent.testing import DeviceContract
from rtagent.units import second
from rtagent_drivers.sorting import dynamics
from rtagent_drivers.sorting.driver import sorting_arm
from rtagent_drivers.sorting.dynamics import GRAVITY, HELD, MASSES, frames, place, torques
from rtagent_drivers.sorting.servos import AMBIENT, MX_28, MX_106, Drives
from rtagent_drivers.sorting.trials import DOWN, ELBOW, HAND, OPEN, PLACES, SHOULDER, START, STEP, UP, WIDTH, trial
from rtagent_drivers.sorting.world import ENDED, SortingWorld
from rtagent_drivers.tables import read_table

COLD = np.full(5, AMBIENT)


class TestSortingArm(DeviceContract):
    def make_device(self):  # type: ignore[no-untyped-def]  # as a user would write it
        return sorting_arm(trials=1)


class TestSortingArmInVirtualTime(TestSortingArm):
    clock: ClockName = "virtual"


def begun(seed: int = 1, trials: int = 1) -> SortingWorld:
    world = SortingWorld(trials)
    world.begin(0, np.random.default_rng(seed))
    return world


def still(pose: list[float], held: float = 0.0) -> np.ndarray:
    return torques(np.tile(pose, (3, 1)), np.full(3, held), STEP)[1]


def test_a_level_arm_weighs_what_its_masses_say() -> None:
    """By hand: 100 g at 127.8 mm, 77 g at 153.3, 235.5 and 285.5, 60 g at 325.5, and 300 g at 351.1 mm."""
    moment = 0.1 * 0.12775 + 0.077 * (0.1533 + 0.2355 + 0.2855) + 0.06 * 0.3255 + 0.3 * 0.351134
    shoulder, elbow, _, flexion = still([0.4, 0.0, 0.0, 0.0], held=0.3)
    assert elbow == pytest.approx(9.81 * moment, rel=1e-4)
    assert flexion == pytest.approx(9.81 * (0.077 * 0.03 + 0.06 * 0.07 + 0.3 * 0.095634), rel=1e-4)
    assert shoulder == pytest.approx(0.0, abs=1e-12)


def test_an_upright_arm_weighs_nothing_on_its_elbow_and_a_turned_wrist_nothing_on_its_flexion() -> None:
    assert still([0.0, pi / 2, 0.0, 0.0])[1] == pytest.approx(0.0, abs=1e-12)
    assert still([0.0, 0.0, pi / 2, 0.0], held=0.2)[3] == pytest.approx(0.0, abs=1e-12)
    # what lies beside the forearm's axis pulls at the wrist's rotation: 77 g by 10 mm and by 15 mm
    assert abs(still([0.0, 0.0, 0.0, 0.0])[2]) == pytest.approx(9.81 * 0.077 * 0.025, rel=1e-6)


@given(st.integers(0, 100))
@settings(max_examples=10)
def test_the_power_of_the_torques_is_the_change_of_the_arms_energy(seed: int) -> None:
    """Kinetic and potential energy come from speeds and heights alone: an independent reckoning."""
    rng, times = np.random.default_rng(seed), np.arange(0, 1, 1e-3)
    angles = np.stack([a * np.sin(w * times + p) for a, w, p in rng.uniform(0.5, 2.0, (4, 3))], axis=1)
    held = np.full(len(times), 0.2)
    energy = np.zeros(len(times))
    for mass in (*MASSES, HELD):
        where = place(mass, frames(angles))
        speed = np.gradient(where, 1e-3, axis=0)
        amount = 0.2 if mass is HELD else mass.mass
        energy += amount * (0.5 * (speed**2).sum(axis=1) - where @ GRAVITY)
    power = (torques(angles, held, 1e-3) * np.gradient(angles, 1e-3, axis=0)).sum(axis=1)
    inside = slice(5, -5)
    np.testing.assert_allclose(power[inside], np.gradient(energy, 1e-3)[inside], atol=2e-3 * np.abs(power).max())


def test_a_motor_without_load_turns_as_fast_as_the_data_sheet_says_and_stalls_where_it_does() -> None:
    drives = Drives([MX_28])
    nothing = np.zeros(1)
    assert drives.duty(nothing, np.array([55 * 2 * pi / 60])) == pytest.approx(1.0)
    stall = drives.torque_at_rest(np.ones(1)) / MX_28.constant  # amperes
    assert stall == pytest.approx(1.4)
    assert drives.duty(drives.torque_at_rest(np.full(1, 0.3)), nothing) == pytest.approx(0.3)


def test_a_servo_under_constant_torque_gets_as_warm_as_its_losses_and_its_case_say() -> None:
    """By hand: 1 Nm is 0.456 A, 0.618 W in 2.965 ohm, and 1.2 W beside; 149.2 cm² give off 0.1492 W/K."""
    drives = Drives([MX_106])
    warm = drives.tends_to(np.ones(1))
    assert warm == pytest.approx(AMBIENT + 1.8177 / 0.149216, rel=1e-3)
    step = MX_106.cooling_time / 1000
    reached = drives.warmed(np.full(1, AMBIENT), np.tile(warm, (1001, 1)), step)
    assert (reached[-1] - AMBIENT) / (warm - AMBIENT) == pytest.approx(1 - exp(-1), rel=1e-6)
    assert MX_106.cooling_time == pytest.approx(0.153 * 900 / 0.149216, rel=1e-4)


def test_temperatures_follow_what_they_tend_to_step_by_step() -> None:
    drives, rng = Drives([MX_28, MX_106]), np.random.default_rng(1)
    tends_to = rng.uniform(20.0, 60.0, (500, 2))
    found = drives.warmed(np.array([30.0, 25.0]), tends_to, 0.5)
    now = np.array([30.0, 25.0])
    for row, each in zip(found, tends_to, strict=True):
        np.testing.assert_allclose(row, now)
        now = each + (now - each) * np.exp(-0.5 / drives.cooling_time)


@pytest.mark.parametrize("place", PLACES)
def test_a_trial_carries_its_object_with_the_elbow_raised_and_returns(place: float) -> None:
    made = trial(place, 0.3, COLD, np.random.default_rng(3))
    borne = made.held == 0.3
    assert borne.any()
    assert not made.held[~borne].max() > 0.3
    turning = np.abs(np.gradient(made.goals[:, SHOULDER], STEP)) > 0.1
    assert made.held[turning & (np.arange(len(turning)) < borne.nonzero()[0][-1])].min() > 0.0
    assert made.goals[borne, ELBOW].max() == pytest.approx(UP, abs=0.15)
    ends = made.goals[[0, -1]]
    np.testing.assert_allclose(ends, np.tile([START, DOWN, 0.0, ends[0, 3], OPEN], (2, 1)))
    dropped = made.goals[np.flatnonzero(made.goals[:, HAND] < WIDTH)[-1], SHOULDER]
    assert dropped == pytest.approx(place, abs=0.15)


def test_the_heavier_the_object_the_more_the_elbow_bears_and_sags() -> None:
    loads, sags = [], []
    for weight in (0.05, 0.15, 0.3):
        made = trial(0.0, weight, COLD, np.random.default_rng(3))
        carried = made.held == weight
        loads.append(made.duties[carried, ELBOW].mean())
        sags.append((made.goals - made.positions)[carried, ELBOW].mean())
    # 100 g more at 0.35 m, nearly level, are 0.34 Nm: R τ / k / 12 V
    assert np.diff(loads) == pytest.approx([0.0388, 0.0388 * 1.5], rel=0.06)
    assert np.all(np.diff(sags) > 0.4 * np.pi / 180)


def test_thirty_trials_of_each_object_take_more_than_sixteen_minutes() -> None:
    world = begun(trials=30)
    assert sorted(world.objects) == [0] * 30 + [1] * 30 + [2] * 30
    number, time = 0, 0
    while (following := world.next_change(time)) is not None:
        number, time = number + 1, following
    assert number == 90
    assert 16 * 60 < time / second < 20 * 60
    assert world.values(time)[ENDED]
    assert not world.values(time - 1)[ENDED]
    assert world.values(time + 10 * second).keys() == world.spec.sensors.keys()


@given(st.lists(st.integers(0, 40 * second), min_size=1, max_size=5), st.integers(0, 3))
@settings(max_examples=10)
def test_its_state_is_a_function_of_time_whoever_looks_and_fits_its_spec(times: list[int], seed: int) -> None:
    looked_at, other = begun(seed), begun(seed)
    expected = {time: other.values(time) for time in sorted(times, reverse=True)}
    for time in times:
        values = looked_at.values(time)
        assert values == expected[time]
        for name, value in values.items():
            looked_at.spec.sensors[name].validate(value, name)


def test_it_tells_whole_counts_of_its_registers() -> None:
    world = begun()
    rows = [world.values(round(row * second / 30)) for row in range(300)]
    for kind, count in (("position", 2 * pi / 4096), ("velocity", 0.114 * 2 * pi / 60), ("load", 1 / 1023)):
        counts = np.array([float(row[f"elbow_{kind}"]) for row in rows]) / count
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert {float(row["elbow_temperature"]) % 1.0 for row in rows} == {0.0}
    steps = np.unique([round(float(row["elbow_load"]) * 1023) for row in rows])
    assert np.diff(steps).min() >= 7  # the controller knows whole counts of the encoder: 7.9 of the load


def test_a_stream_of_another_number_has_the_same_trials_in_another_order() -> None:
    one, other = named("sorting", trials=2, shuffle=0), named("sorting", trials=2, shuffle=1)
    assert len(one) == len(other) > 6 * 9 * 30
    assert not np.array_equal(one.column("shoulder_position"), other.column("shoulder_position"))
    for name in one.columns:
        assert np.array_equal(np.sort(one.column(name)), np.sort(other.column(name)))
    assert one.ranges == other.ranges
    assert one.last.nonzero()[0].tolist() == [len(one) - 1]


@pytest.mark.parametrize("wrong", [{"trials": 0}, {"weights": (0.1,)}, {"weights": (0.0, 0.1, 0.2)}])
def test_what_cannot_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(SpecError, match="give"):
        sorting_arm(**wrong)  # type: ignore[arg-type]  # that is the point


@pytest.mark.slow
def test_a_stream_is_written_by_a_command(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv.gz"
    command = [
        sys.executable,
        "-m",
        "rtagent_drivers.sorting.streams",
        str(path),
        "--trials",
        "1",
        "--shuffle",
        "2",
    ]
    subprocess.run(command, check=True)
    table = read_table(path)
    assert np.array_equal(table.columns["elbow_load"], named("sorting", trials=1, shuffle=2).column("elbow_load"))


def test_masses_are_those_of_the_servos() -> None:
    assert sum(mass.mass for mass in MASSES) == pytest.approx(3 * MX_28.mass + 0.16)
    assert pytest.approx(0.351134, abs=1e-6) == dynamics.FOREARM + dynamics.GRIP
