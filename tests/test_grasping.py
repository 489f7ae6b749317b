"""The grasping experiment: its trials, what its devices show of them, and the stream of all three."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from helpers import RampWorld
from numpy.typing import NDArray
from parts import SCENARIOS

from rtagent import clock
from rtagent.device import Device
from rtagent.errors import SpecError
from rtagent.experience import Observation, Values
from rtagent.experiments.streams import named
from rtagent.scenario import assemble, load
from rtagent.specs import Spec
from rtagent.streams import shared, stream
from rtagent.units import ms, second
from rtagent_drivers.arduino.bodies import BODIES
from rtagent_drivers.fake import FakeDevice, Faults, Sampling
from rtagent_drivers.grasping.assumed import JOINTS
from rtagent_drivers.grasping.hands import Gestures, Grasp
from rtagent_drivers.grasping.session import FINGERS, THINGS, TRIAL, Session
from rtagent_drivers.grasping.streams import merged
from rtagent_drivers.grasping.view import View
from rtagent_drivers.webcam.features import Features
from rtagent_drivers.webcam.scenes import CameraWorld

Times = NDArray[np.int64]

DOWN = {
    ("green", False): {"middle", "ring", "pinky"},
    ("orange", True): {"ring", "pinky"},
    ("green", True): {"pinky"},
    ("orange", False): set(),
}
"""Figure 5.1's table: cylinders are not stepped."""


@pytest.fixture(scope="module")
def session() -> Session:
    return Session(np.random.default_rng(1))


def within_trials(session: Session, seconds: float) -> Times:
    """Return the moment so many seconds after the beginning of each trial."""
    return np.arange(len(session)) * TRIAL + round(seconds * 1e9)


def test_each_object_comes_as_often_as_in_the_thesis_and_in_no_order(session: Session) -> None:
    kinds = [(THINGS[thing].colour, THINGS[thing].stepped) for thing in session.things]
    counted = {("green", False): 31, ("orange", True): 33, ("green", True): 33, ("orange", False): 34}
    assert Counter(kinds) == counted
    assert sum(one != other for one, other in pairwise(kinds)) > 65
    assert Session(np.random.default_rng(2)).things.tolist() != session.things.tolist()


def test_the_fingers_that_the_table_names_are_down_during_the_grasp_and_only_then(session: Session) -> None:
    gestures = Gestures(session)
    bends = gestures.bends(within_trials(session, 5.5))
    for trial, thing in enumerate(session.things):
        down = {finger for finger, bend in zip(FINGERS, bends[:, trial], strict=True) if bend > 0.5}
        assert down == DOWN[THINGS[thing].colour, THINGS[thing].stepped]
    for neutral in (0.0, 3.0, 8.5):
        assert gestures.bends(within_trials(session, neutral)).max() < 0.2


def test_no_finger_begins_or_goes_back_before_the_hand_has_moved(session: Session) -> None:
    gestures = Gestures(session)
    before, held = (gestures.bends(within_trials(session, at)) for at in (3.0, 6.0))
    assert np.abs(gestures.bends(within_trials(session, 3.05)) - before).max() < 0.01
    assert np.abs(gestures.bends(within_trials(session, 6.05)) - held).max() < 0.01


def test_the_hand_closes_after_three_seconds_holds_for_three_and_opens(session: Session) -> None:
    grasp, index = Grasp(session), list(JOINTS).index("D2I")
    opened, closed = (
        grasp.joints(within_trials(session, 2.99))[index],
        grasp.joints(within_trials(session, 3.6))[index],
    )
    assert (closed - opened).min() > 0.3
    assert np.allclose(grasp.joints(within_trials(session, 6.0))[index], closed)
    assert np.allclose(grasp.joints(within_trials(session, 6.6))[index], opened)
    assert np.allclose(grasp.joints(within_trials(session, 0.0))[index], opened)
    halfway = grasp.joints(within_trials(session, 3.0 + 0.6 * 0.65))[index]  # it moves from 0.3 of the way on
    assert np.allclose(halfway, (opened + closed) / 2)


def test_index_and_ring_close_further_on_steps_and_no_other_joint_does(session: Session) -> None:
    grasp = Grasp(session)
    moved = grasp.joints(within_trials(session, 5.0)) - grasp.joints(within_trials(session, 2.0))
    further = moved[:, session.stepped].mean(axis=1) - moved[:, ~session.stepped].mean(axis=1)
    spread = moved.std(axis=1).max() / np.sqrt(len(session) / 4)
    told_apart = {name for name, each in zip(JOINTS, further, strict=True) if abs(each) > 4 * spread}
    assert told_apart == {"D2I", "D4P"}


def test_only_the_thumbs_distal_joint_drifts_and_the_thumb_does_not_rotate(session: Session) -> None:
    opened = Grasp(session).joints(within_trials(session, 1.0))
    spreads = dict(zip(JOINTS, opened.std(axis=1), strict=True))
    drifting = max(spreads, key=lambda name: spreads[name])
    assert drifting == "D1D"
    assert spreads["D1D"] > 5 * max(spread for name, spread in spreads.items() if name != "D1D")
    rotation = Grasp(session).joints(within_trials(session, 5.0))[0]
    assert np.allclose(rotation, opened[0])


def test_a_camera_sees_the_colour_of_what_is_held_and_nothing_when_it_is_away(session: Session) -> None:
    view = View(session, (640, 480))
    red, green, _ = view.means(within_trials(session, 2.5)) - view.means(within_trials(session, 0.2))
    assert ((green > red) == session.green).all()
    assert np.abs(view.means(within_trials(session, 8.9)) - view.means(within_trials(session, 0.2))).max() < 0.01


def test_means_are_those_of_the_pictures_exactly() -> None:
    size = (64, 48)
    world = CameraWorld(size, Features(size, True, {}, None))
    world.begin(5 * second, stream(1, "device", "webcam", 0, 0))
    times = 5 * second + np.arange(0, 27 * second, 370 * ms)
    drawn = [world.values(int(time)) for time in times]
    told = world.columns(times)
    assert {name: list(values) for name, values in told.items()} == {
        name: pytest.approx([row[name] for row in drawn], abs=1e-12) for name in ("red", "green", "blue")
    }
    assert min(np.ptp(values) for values in told.values()) > 0.01


def test_an_object_that_comes_is_a_stimulus_and_a_change_is_foreseen(session: Session) -> None:
    entries = session.entries(-1, 3 * TRIAL)
    assert entries == [trial * TRIAL + int(session.enters[trial]) for trial in range(3)]
    assert session.entries(entries[0], entries[1]) == [entries[1]]
    assert session.next_change(0) == entries[0]
    assert session.next_change(entries[0]) == 3 * second
    assert session.next_change(3 * second) == 6 * second
    assert session.next_change(8 * second) == entries[1]


@pytest.mark.parametrize("body", ["grasping", "glove"])
def test_a_body_reads_the_same_at_once_and_one_by_one(body: str) -> None:
    made = BODIES[body]()
    made.begin(second, stream(3, "device", "x", 0, 0))
    times = second + np.arange(0, 20 * second, 310 * ms)
    scan = made.scan(times)  # type: ignore[attr-defined]  # those of the experiment have it
    for pin in ("2", "A6", "A9", "A11") if body == "grasping" else ("A2", "A5"):
        assert [made.reading(pin, int(time)) for time in times] == scan[pin].tolist()
    assert made.reading("A1", int(times[0])) == made.reading("A1", int(times[0]))


def test_devices_of_an_episode_have_a_stream_in_common_and_those_of_others_have_not() -> None:
    hand, glove = (stream(1, "device", name, 0, 2) for name in ("hand", "glove"))
    drawn = hand.random()
    same = shared(hand, "x").random()
    assert shared(glove, "x").random() == same
    assert shared(stream(1, "device", "hand", 0, 3), "x").random() != same
    assert shared(stream(2, "device", "hand", 0, 2), "x").random() != same
    assert shared(hand, "y").random() != same
    assert stream(1, "device", "hand", 0, 2).random() == drawn, "the device's own is left as it was"


def test_hand_glove_and_camera_agree_on_every_trial() -> None:
    made = named("grasping", trials=20, seed=4)
    rows = np.rint((np.arange(20) * 9 + 5.5) * made.rate).astype(int)
    colours = np.where(made.unit("green")[rows] > made.unit("red")[rows], "green", "orange")
    stepped = made.unit("index_intermediate")[rows] > 0.88
    for trial, kind in enumerate(zip(colours.tolist(), stepped.tolist(), strict=True)):
        down = {name for name in ("middle", "ring", "pinky") if made.unit(f"{name}_bend")[rows[trial]] > 0.5}
        assert down == DOWN[kind]


def test_the_stream_has_the_gloves_rate_and_the_others_newest_samples() -> None:
    made = named("grasping", trials=2, seed=0)
    assert len(made) == pytest.approx(18 * 750, abs=40)  # the first frame takes its time
    changes = {name: np.count_nonzero(np.diff(made.column(name))) for name in made.columns}
    assert 0.4 * 18 * 15 < changes["red"] <= 18 * 15
    assert 0.6 * 18 * 70 < changes["ring_proximal"] <= 18 * 70
    assert np.count_nonzero(np.diff(made.column("button")) > 0) == 1, "the second trial's"


def test_what_is_merged_is_what_had_arrived() -> None:
    devices: dict[str, Device] = {
        "fast": FakeDevice(Named("fast"), Sampling(100.0)),
        "slow": FakeDevice(Named("slow"), Sampling(20.0, delay=30 * ms)),
    }
    times, columns = merged(devices, "fast", 200 * ms, 0)
    assert times.tolist() == [at * 10 * ms for at in range(3, 20)]
    assert columns["fast"].tolist() == [at * 10 * ms for at in range(3, 20)]
    assert columns["slow"].tolist() == [0.0] * 5 + [50.0 * ms] * 5 + [100.0 * ms] * 5 + [150.0 * ms] * 2


def test_sensors_of_one_name_are_refused_in_a_stream() -> None:
    devices: dict[str, Device] = {name: FakeDevice(Named("same"), Sampling(100.0)) for name in ("one", "other")}
    with pytest.raises(SpecError, match="two devices sense something called 'same'"):
        merged(devices, "one", second, 0)


def test_only_fakes_in_the_process_without_faults_are_foretold() -> None:
    rng = np.random.default_rng(0)
    for device in (
        FakeDevice(RampWorld()),
        FakeDevice(RampWorld(), Sampling(10.0, jitter=1)),
        FakeDevice(RampWorld(), Sampling(10.0), Faults(drop=0.1)),
    ):
        with pytest.raises(SpecError, match="can be foretold"):
            device.foretold(rng, second)


class Named(RampWorld):
    """A ramp (ns since it began) whose sensor has a name of its own."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name
        self.spec = replace(self.spec, sensors={name: Spec()})

    def values(self, time: int) -> Values:
        return {self._name: float(time - self.began[-1])}


@dataclass
class Watching:
    """Takes down when an episode began and what is observed."""

    began: int
    seen: list[Observation]

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        self.began = time

    def observed(self, observation: Observation, stimuli: object) -> None:
        self.seen.append(observation)


def test_a_run_observes_what_the_stream_foretells() -> None:
    settings = ["run.fake=process", "run.clock=virtual", "run.episode_time=1s", "features.prototypes=100"]
    path, watching = SCENARIOS / "grasping.toml", Watching(0, [])
    clock.run(assemble(load(path, settings)).run([watching]), "virtual")
    told = {
        name: device.foretold(stream(1, "device", name, 0, 0), second)
        for name, device in assemble(load(path, settings)).devices.items()
        if isinstance(device, FakeDevice)
    }
    assert len(watching.seen) > 700
    for observation in watching.seen[1::7]:  # the first waited for the first frame of the camera
        for name, sample in observation.samples.items():
            arrivals, columns = told[name]
            newest = np.searchsorted(arrivals, observation.time - watching.began, side="right") - 1
            assert sample.arrival_time - watching.began == arrivals[newest]
            assert {key: float(sample.values[key]) for key in columns} == pytest.approx(
                {key: float(values[newest]) for key, values in columns.items()}, abs=1e-12
            )
