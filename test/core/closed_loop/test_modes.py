# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The table of modes: complete, as its rules say, and as docs/control_loop.md draws it.

The expectations are written by hand and not read from the table.
"""

from pathlib import Path

from obc_ros.core.closed_loop.modes import (
    Effect,
    Event,
    FOLLOWING,
    Mode,
    NO_EFFECTS,
    Switch,
    switch_mode,
    TABLE,
)
import pytest

PAGE = Path(__file__).resolve().parents[3] / 'docs' / 'control_loop.md'
NOT_FOLLOWING = set(Mode) - set(FOLLOWING)
# After these the plant may be anywhere, or time has another meaning.
NEW_WORLD = {Event.STOP, Event.RESTART, Event.FRAME, Event.DEACTIVATE}
NEW_PLACE = {Event.OUTAGE, Event.JUMP, Event.REPLACED}


def test_every_mode_and_event_has_an_entry() -> None:
    """An event in a mode is never a surprise."""
    assert set(TABLE) == set(Event)
    assert all(set(row) == set(Mode) for row in TABLE.values())


@pytest.mark.parametrize('event', list(Event))
def test_a_stop_lasts_until_start(event: Event) -> None:
    """Nothing but START leaves STOPPED, and START waits for a state."""
    wanted = Mode.WAITING if event is Event.START else Mode.STOPPED
    assert switch_mode(Mode.STOPPED, event).mode is wanted


@pytest.mark.parametrize('mode', list(Mode))
def test_a_stop_acts_in_every_mode(mode: Mode) -> None:
    """Also before the first state, while the law rests, and in an inactive node."""
    assert switch_mode(mode, Event.STOP) == Switch(Mode.STOPPED, frozenset({Effect.DROP}))


@pytest.mark.parametrize('event', list(Event))
def test_an_inactive_loop_begins_by_activation_only(event: Event) -> None:
    """A stop is kept for the time after the activation."""
    wanted = {Event.ACTIVATE: Mode.WAITING, Event.STOP: Mode.STOPPED}.get(event, Mode.INACTIVE)
    assert switch_mode(Mode.INACTIVE, event).mode is wanted


@pytest.mark.parametrize('mode', list(Mode))
def test_an_activation_begins_a_run(mode: Mode) -> None:
    """Whatever was followed before is over; only a stop goes on."""
    wanted = Mode.STOPPED if mode is Mode.STOPPED else Mode.WAITING
    assert switch_mode(mode, Event.ACTIVATE).mode is wanted
    assert mode not in (Mode.RESTING, *FOLLOWING) or (
        switch_mode(mode, Event.ACTIVATE).effects == {Effect.DROP})


@pytest.mark.parametrize('mode', list(Mode))
def test_deactivation_ends_a_run_but_no_stop(mode: Mode) -> None:
    """A node that was stopped is stopped after the next activation, too."""
    wanted = Mode.STOPPED if mode is Mode.STOPPED else Mode.INACTIVE
    assert switch_mode(mode, Event.DEACTIVATE).mode is wanted
    assert mode is Mode.INACTIVE or switch_mode(mode, Event.DEACTIVATE).effects == {Effect.DROP}


def test_only_a_state_leads_to_following() -> None:
    """STATE begins the law, BACK and RESUME resume it, and all three begin with the set point."""
    begins = {(mode, event, switch_mode(mode, event).mode)
              for mode in NOT_FOLLOWING for event in Event
              if switch_mode(mode, event).mode in FOLLOWING}
    assert begins == {(Mode.WAITING, Event.STATE, Mode.SET_POINT),
                      (Mode.RESTING, Event.BACK, Mode.SET_POINT),
                      (Mode.RESTING, Event.RESUME, Mode.SET_POINT)}
    for mode, event, _ in begins:
        assert switch_mode(mode, event).effects >= {Effect.PLACE, Effect.ANEW, Effect.FADE}


@pytest.mark.parametrize('mode', [Mode.REFERENCE, Mode.RESTING])
def test_a_reference_is_judged_or_dropped_after_a_discontinuity(mode: Mode) -> None:
    """What was followed goes on only after it was judged; RESTING remembers it."""
    for event in NEW_WORLD:
        assert switch_mode(mode, event).effects == {Effect.DROP}
    for event in NEW_PLACE:
        assert Effect.JUDGE in switch_mode(mode, event).effects
    for event in (Event.BACK, Event.RESUME):
        assert Effect.JUDGE in switch_mode(Mode.RESTING, event).effects


@pytest.mark.parametrize('mode', sorted(set(Mode) - {Mode.INACTIVE, Mode.STOPPED},
                                        key=lambda mode: mode.value))
def test_plans_are_given_up_after_a_discontinuity(mode: Mode) -> None:
    """A plan begins at a state, and the plant is at another one."""
    for event in NEW_WORLD:
        assert switch_mode(mode, event).effects == {Effect.DROP}
    for event in NEW_PLACE:
        assert Effect.CLEAR in switch_mode(mode, event).effects
    assert switch_mode(mode, Event.SUSPEND).effects == (
        {Effect.CLEAR} if mode in FOLLOWING else NO_EFFECTS)
    assert Effect.CLEAR in switch_mode(Mode.RESTING, Event.BACK).effects
    if mode is not Mode.RESTING:
        assert switch_mode(mode, Event.LOST).effects == {Effect.CLEAR}


@pytest.mark.parametrize('mode', FOLLOWING)
def test_a_law_goes_on_at_the_plant_after_a_discontinuity(mode: Mode) -> None:
    """The set point moves on from the plant, and the command fades in from the one sent."""
    for event in NEW_PLACE:
        change = switch_mode(mode, event)
        assert change.mode is (Mode.SET_POINT if mode is Mode.PLAN else mode)
        assert change.effects >= {Effect.PLACE, Effect.FADE}
    for event in (Event.RESTART, Event.FRAME):
        assert switch_mode(mode, event).mode is Mode.WAITING


@pytest.mark.parametrize('mode', [Mode.WAITING, *FOLLOWING])
def test_missing_states_suspend_every_law(mode: Mode) -> None:
    """Also one that has yet to begin: the last command may still act."""
    assert switch_mode(mode, Event.LOST).mode is Mode.RESTING


def test_rules_suspend_what_is_followed_and_nothing_else() -> None:
    """A state that is outside of x_limits neither ends a stop nor begins a run."""
    assert {mode for mode in Mode if switch_mode(mode, Event.SUSPEND).mode is Mode.RESTING} == {
        *FOLLOWING, Mode.RESTING}
    for mode in NOT_FOLLOWING:
        assert switch_mode(mode, Event.SUSPEND) == Switch(mode, NO_EFFECTS)


def test_references_come_before_plans_and_plans_before_the_set_point() -> None:
    """A plan does not interrupt a reference; without both the set point is held."""
    assert [switch_mode(mode, Event.BEGIN).mode for mode in FOLLOWING] == [Mode.REFERENCE] * 3
    assert switch_mode(Mode.REFERENCE, Event.PLANNED) == Switch(Mode.REFERENCE, NO_EFFECTS)
    assert switch_mode(Mode.SET_POINT, Event.PLANNED).mode is Mode.PLAN
    assert switch_mode(Mode.PLAN, Event.UNPLANNED).mode is Mode.SET_POINT
    assert switch_mode(Mode.REFERENCE, Event.END).mode is Mode.SET_POINT
    assert switch_mode(Mode.REFERENCE, Event.WITHDRAWN).mode is Mode.SET_POINT


def test_a_plan_that_replaces_a_plan_is_no_event() -> None:
    """It restarts no transition."""
    assert switch_mode(Mode.PLAN, Event.PLANNED) == Switch(Mode.PLAN, NO_EFFECTS)


@pytest.mark.parametrize('mode', FOLLOWING)
def test_changes_fade_in(mode: Mode) -> None:
    """Every change of what is followed, and of its parameters, begins at the command sent."""
    assert switch_mode(mode, Event.ADOPT) == Switch(mode, frozenset({Effect.FADE}))
    for event in (Event.BEGIN, Event.END, Event.WITHDRAWN, Event.PLANNED, Event.UNPLANNED):
        change = switch_mode(mode, event)
        assert change.mode is mode or Effect.FADE in change.effects


@pytest.mark.parametrize('mode', sorted(NOT_FOLLOWING, key=lambda mode: mode.value))
def test_what_is_followed_has_no_events_where_nothing_is(mode: Mode) -> None:
    """References and plans begin and end while a law is at work."""
    for event in (Event.BEGIN, Event.END, Event.WITHDRAWN, Event.PLANNED, Event.UNPLANNED,
                  Event.ADOPT):
        if (mode, event) != (Mode.RESTING, Event.BEGIN):
            assert switch_mode(mode, event) == Switch(mode, NO_EFFECTS)


def describe(mode: Mode, change: Switch) -> str:
    """Return a cell of the table of the page."""
    effects = [effect.name.lower() for effect in Effect if effect in change.effects]
    return ', '.join(([change.mode.name] if change.mode is not mode else []) + effects) or '–'


def test_the_page_shows_the_table() -> None:
    """Compare the table of modes and events in docs/control_loop.md with the code."""
    rows = [[cell.strip() for cell in line.strip('|').split('|')]
            for line in PAGE.read_text(encoding='utf-8').splitlines()
            if line.startswith('| ') and line.count('|') == len(Mode) + 2]
    assert rows[0] == ['event', *(mode.name for mode in Mode)]
    assert rows[1:] == [[event.name, *(describe(mode, switch_mode(mode, event)) for mode in Mode)]
                        for event in Event]


def test_the_page_explains_every_mode_event_and_effect() -> None:
    """Each name has a line of its own."""
    text = PAGE.read_text(encoding='utf-8')
    named = [f'`{name}`' for name in (*Mode.__members__, *Event.__members__)] + [
        f'*{effect.name.lower()}*' for effect in Effect]
    assert [each for each in named if f'| {each} |' not in text] == []
