"""The fake arm: a function of time that keeps to its own mechanics, another in each episode."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtagent.clock import ClockName
from rtagent.errors import SpecError
from rtagent.testing import DeviceContract
from rtagent.units import ms, second
from rtagent_drivers import arm as arm_module
from rtagent_drivers.arm import AMBIENT, HEATING, TIME_CONSTANT, ArmWorld, arm, main, minimum_jerk
from rtagent_drivers.tables import read_table


class TestArm(DeviceContract):
    def make_device(self):  # type: ignore[no-untyped-def]  # as a user would write it
        return arm()


class TestArmInVirtualTime(TestArm):
    clock: ClockName = "virtual"


@pytest.fixture
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the noise away, so that what is left is mechanics."""
    monkeypatch.setattr(arm_module, "NOISE", (0.0, 0.0, 0.0, 0.0))


def begun(seed: int = 1, joints: int = 5, now: int = 0) -> ArmWorld:
    world = ArmWorld(joints)
    world.begin(now, np.random.default_rng(seed))
    return world


def series(world: ArmWorld, sensor: str, times: np.ndarray) -> np.ndarray:
    return np.array([float(world.values(int(time))[sensor]) for time in times])


@given(st.lists(st.integers(0, 100 * second), min_size=1, max_size=10), st.integers(0, 10 * second))
def test_its_state_is_a_function_of_time_whoever_looks(times: list[int], now: int) -> None:
    looked_at, other = begun(now=now), begun(now=now)
    other.values(now + 100 * second)
    expected = {time: other.values(now + time) for time in sorted(times, reverse=True)}
    assert [looked_at.values(now + time) for time in times] == [expected[time] for time in times]


@given(st.integers(0, 1000), st.integers(1, 32), st.integers(0, 600 * second))
def test_what_it_senses_fits_its_spec(seed: int, joints: int, time: int) -> None:
    world = begun(seed, joints)
    assert len(world.spec.sensors) == 4 * joints
    for name, value in world.values(time).items():
        world.spec.sensors[name].validate(value, name)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("joint", ["shoulder", "elbow", "wrist_flexion", "hand"])
def test_velocity_is_the_derivative_of_position(joint: str) -> None:
    world, times = begun(), np.arange(0, 30 * second, 10 * ms)
    position, velocity = series(world, f"{joint}_position", times), series(world, f"{joint}_velocity", times)
    assert np.ptp(position) > 0.4
    np.testing.assert_allclose(np.gradient(position, 0.01)[1:-1], velocity[1:-1], atol=0.05)


@pytest.mark.usefixtures("quiet")
def test_temperature_follows_the_load_by_a_first_order_law() -> None:
    world, step = begun(), 20 * ms
    times = np.arange(0, 200 * second, step)
    load, temperature = series(world, "elbow_load", times), series(world, "elbow_temperature", times)
    expected = AMBIENT
    for each in load:
        expected += (AMBIENT + HEATING * each**2 - expected) * step / second / TIME_CONSTANT
    assert expected > AMBIENT + 3.0
    assert temperature[0] == AMBIENT
    assert temperature[-1] == pytest.approx(expected, rel=0.02)


@given(st.floats(0.001, 0.999))
def test_minimum_jerk_is_its_own_derivatives_and_rests_at_its_ends(time: float) -> None:
    near = 1e-6
    before, at, after = minimum_jerk(time - near), minimum_jerk(time), minimum_jerk(time + near)
    assert (after[0] - before[0]) / (2 * near) == pytest.approx(at[1], abs=1e-6)
    assert (after[1] - before[1]) / (2 * near) == pytest.approx(at[2], abs=1e-6)
    assert (minimum_jerk(0.0), minimum_jerk(1.0)) == ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))


def test_each_cycle_and_each_episode_is_a_little_different() -> None:
    times = np.arange(0, 60 * second, 100 * ms)
    one, same, other = (series(begun(seed), "shoulder_position", times) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert np.abs(one - other).max() > 0.05
    lowest = [segment.min() for segment in np.split(one, 5)]
    assert len(set(np.round(lowest, 3))) > 1
    assert np.ptp(lowest) < 0.6


def test_its_noise_is_small_and_without_mean() -> None:
    world, times = begun(), np.arange(0, 500 * ms, 1 * ms)  # it rests at home
    for sensor, size in [("shoulder_position", 0.002), ("wrist_rotation_temperature", 0.2)]:
        values = series(world, sensor, times)
        noise = values - values.mean()
        assert 0.9 * size < np.abs(noise).max() < 1.1 * size
        assert abs(values[:250].mean() - values[250:].mean()) < 0.1 * size
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.15


@pytest.mark.parametrize("joints", [0, 33])
def test_a_number_of_joints_that_no_arm_has_is_refused(joints: int) -> None:
    with pytest.raises(SpecError, match="1 to 32"):
        arm(joints=joints)


def test_further_joints_have_names_of_their_own() -> None:
    names = [name.removesuffix("_position") for name in arm(joints=7).spec.sensors if name.endswith("_position")]
    assert names == ["shoulder", "elbow", "wrist_rotation", "wrist_flexion", "hand", "joint_6", "joint_7"]


@pytest.mark.slow
def test_a_recording_of_it_is_written_by_a_command(tmp_path: Path) -> None:
    path = tmp_path / "arm.csv.gz"
    command = [sys.executable, "-m", "rtagent_drivers.arm", str(path), "--duration", "2s", "--joints", "2"]
    subprocess.run(command, check=True)
    table = read_table(path)
    assert (len(table.times), len(table.columns)) == (61, 8)
    with pytest.raises(SystemExit):
        main([str(tmp_path / "no" / "folder.csv")])
