"""Reaction times: which act answers which stimulus, and what was missed."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from helpers import run_joint
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import Schedule, Stimulus, ms
from rtagent.costs import Cost
from rtagent.reaction import EpisodeReactions, ReactionTimer
from rtagent.schedule import ACT, CHOOSE, OBSERVE

MOVE, STOP = 0, 1


def timer() -> ReactionTimer:
    return ReactionTimer(lambda action, stimulus: action == STOP)


def test_a_reaction_is_sensing_deciding_and_acting() -> None:
    reactions = timer()
    stimulus = Stimulus(100)
    reactions.observed([stimulus], 130)
    reactions.chose()
    (reaction,) = reactions.acted(MOVE, 150, 157)
    assert (reaction.sensing, reaction.deciding, reaction.acting) == (30, 20, 7)
    assert reaction.time == 57
    assert reaction.stimulus == stimulus


def test_an_act_chosen_before_the_observation_is_no_reaction_to_it() -> None:
    reactions = timer()
    reactions.chose()
    reactions.observed([Stimulus(100)], 130)
    assert list(reactions.acted(STOP, 131, 132)) == []
    reactions.chose()
    assert len(reactions.acted(STOP, 140, 141)) == 1


def test_a_wrong_reaction_is_a_reaction_and_the_first_correct_one_the_response() -> None:
    reactions = timer()
    reactions.observed([Stimulus(100)], 110)
    reactions.chose()
    assert len(reactions.acted(MOVE, 110, 120)) == 1
    reactions.chose()
    assert len(reactions.acted(STOP, 130, 145)) == 0
    reactions.chose()
    reactions.acted(STOP, 150, 160)
    episode = reactions.end([])
    assert [reaction.time for reaction in episode.reactions] == [20]
    assert episode.responses == [45]
    assert (episode.missed_reactions, episode.missed_responses, episode.anticipated) == (0, 0, 0)


def test_a_stimulus_without_a_correct_answer_is_a_missed_response_but_no_missed_reaction() -> None:
    reactions = timer()
    reactions.observed([Stimulus(100)], 110)
    reactions.chose()
    reactions.acted(MOVE, 110, 120)
    episode = reactions.end([])
    assert (episode.missed_reactions, episode.missed_responses) == (0, 1)


def test_a_stimulus_that_nobody_saw_is_missed() -> None:
    reactions = timer()
    reactions.chose()
    reactions.acted(MOVE, 10, 20)
    episode = reactions.end([Stimulus(100)])
    assert (episode.missed_reactions, episode.missed_responses, episode.anticipated) == (1, 1, 0)


def test_a_correct_act_that_was_chosen_before_the_stimulus_was_seen_anticipates_it() -> None:
    reactions = timer()
    reactions.chose()
    reactions.acted(STOP, 90, 120)
    reactions.observed([Stimulus(100)], 130)
    # the second happens at the very moment at which the act is over
    episode = reactions.end([Stimulus(120)])
    assert (episode.missed_reactions, episode.missed_responses, episode.anticipated) == (0, 0, 2)


def test_an_act_that_was_over_before_the_stimulus_does_not_anticipate_it() -> None:
    reactions = timer()
    reactions.chose()
    reactions.acted(STOP, 80, 90)
    assert reactions.end([Stimulus(100)]).anticipated == 0


def test_a_beginning_episode_knows_nothing_of_the_last() -> None:
    reactions = timer()
    reactions.observed([Stimulus(100)], 110)
    reactions.chose()
    reactions.acted(STOP, 115, 125)
    first = reactions.end([])
    reactions.begin()
    assert reactions.end([Stimulus(120)]).anticipated == 0
    reactions.begin()
    assert list(reactions.acted(STOP, 120, 130)) == []
    assert reactions.end([]) == EpisodeReactions()
    assert (len(first.responses), first.missed_responses) == (1, 0)


def test_a_stimulus_that_is_forgotten_by_a_beginning_episode_is_never_answered() -> None:
    reactions = timer()
    reactions.observed([Stimulus(100)], 110)
    reactions.chose()
    reactions.begin()
    assert list(reactions.acted(STOP, 120, 130)) == []


# Against a slow simulation

Event = tuple[str, int]
EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("stimulus"), st.just(0)),
        st.tuples(st.just("observe"), st.just(0)),
        st.tuples(st.just("choose"), st.just(0)),
        st.tuples(st.just("act"), st.sampled_from([MOVE, STOP])),
    ),
    max_size=25,
)


def expected_of(events: Sequence[Event]) -> tuple[list[int], list[int], int, int, int]:
    """Follow each stimulus alone through all events: one event every 10 ns, and an act takes 4."""
    reactions, responses, missed_reactions, missed_responses, anticipated = [], [], 0, 0, 0
    acts = [(place * 10 + 4, value) for place, (kind, value) in enumerate(events) if kind == "act"]
    for born, (kind, _) in enumerate(events):
        if kind != "stimulus":
            continue
        seen = next((n for n in range(born, len(events)) if events[n][0] == "observe"), len(events))
        chosen = next((n for n in range(seen, len(events)) if events[n][0] == "choose"), len(events))
        after = [n for n in range(chosen, len(events)) if events[n][0] == "act"]
        right = [n for n in after if events[n][1] == STOP]
        reactions += [(n - born) * 10 + 4 for n in after[:1]]
        responses += [(n - born) * 10 + 4 for n in right[:1]]
        was_anticipated = not after and acts and acts[-1][0] >= born * 10 and acts[-1][1] == STOP
        anticipated += bool(was_anticipated)
        missed_reactions += not after and not was_anticipated
        missed_responses += not right and not was_anticipated
    return sorted(reactions), sorted(responses), missed_reactions, missed_responses, anticipated


@given(EVENTS)
@settings(max_examples=300)
def test_reactions_are_those_of_a_slow_simulation(events: list[Event]) -> None:
    reactions, unseen = timer(), []
    for place, (kind, value) in enumerate(events):
        time = place * 10
        if kind == "stimulus":
            unseen.append(Stimulus(time, f"number {place}"))
        elif kind == "observe":
            reactions.observed(unseen, time)
            unseen = []
        elif kind == "choose":
            reactions.chose()
        else:
            reactions.acted(value, time, time + 4)
    episode = reactions.end(unseen)
    found = (
        sorted(reaction.time for reaction in episode.reactions),
        sorted(episode.responses),
        episode.missed_reactions,
        episode.missed_responses,
        episode.anticipated,
    )
    assert found == expected_of(events)


# In a run


@pytest.mark.parametrize("preset", ["reactive", "standard"])
def test_what_the_components_cost_is_found_again_in_the_parts_of_a_reaction(preset: str) -> None:
    costs = {OBSERVE: Cost(1 * ms), CHOOSE: Cost(2 * ms), ACT: Cost(3 * ms)}
    delay = 40 * ms
    result = run_joint(Schedule.preset(preset, learn_delay=delay), episodes=10, costs=costs)
    reactions = [reaction for episode in result.episodes for reaction in episode.reactions.reactions]
    assert len(reactions) >= 5
    for reaction in reactions:
        assert reaction.acting == 3 * ms
        assert reaction.deciding == (3 * ms if preset == "reactive" else 3 * ms + delay)
        # the longest wait for a look is a whole cycle
        assert 0 <= reaction.sensing <= delay + 6 * ms
        assert reaction.sensing + reaction.deciding + reaction.acting == reaction.time
