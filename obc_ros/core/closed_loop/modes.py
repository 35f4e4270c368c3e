# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The modes of a control loop, the events that change them, and what each change requires.

The table is data. It has an entry for every mode and event, and nothing else decides: the loop
reports events and carries out effects.
"""

from enum import auto, Enum
from typing import NamedTuple


class _Name(Enum):
    """A name that is looked up at every state: its hash is that of its identity, which is fast."""

    __hash__ = object.__hash__


class Mode(_Name):
    """What a loop does with a state."""

    INACTIVE = auto()    # nothing: the node is not active
    WAITING = auto()     # no command yet: the next state begins the control law
    SET_POINT = auto()   # hold the set point, or the end of a reference
    REFERENCE = auto()   # follow a reference
    PLAN = auto()        # follow a plan that is computed again at each state
    RESTING = auto()     # a rule has suspended the control law, until its reason is gone
    STOPPED = auto()     # the input at rest, until `start`


FOLLOWING = (Mode.SET_POINT, Mode.REFERENCE, Mode.PLAN)


class Event(_Name):
    """What can happen to a loop."""

    ACTIVATE = auto()
    DEACTIVATE = auto()
    STOP = auto()         # by a service, outside of `x_limits`, or far from what was followed
    START = auto()
    STATE = auto()        # a valid state for which a command is due
    LOST = auto()         # no valid state for `state_timeout`
    BACK = auto()         # a valid state after that
    OUTAGE = auto()       # the stamps have jumped ahead by more than `state_timeout`
    RESTART = auto()      # the stamps have jumped back by more than that
    JUMP = auto()         # the source of the states says that it has begun anew
    REPLACED = auto()     # another node publishes the states
    FRAME = auto()        # the states are in another frame
    ADOPT = auto()        # changed parameters
    BEGIN = auto()        # a reference begins, near enough to the state
    END = auto()          # the followed reference ends
    WITHDRAWN = auto()    # the reference that is followed, or whose end is held, is given up
    PLANNED = auto()      # there is a plan for this state
    UNPLANNED = auto()    # there is no plan for this state
    SUSPEND = auto()      # outside of `x_limits`, states too slow, or no plan and no regulator
    RESUME = auto()       # the reason of that is gone


class Effect(_Name):
    """What a change of mode requires; all but DROP and CLEAR are carried out with a state."""

    DROP = auto()    # all references and plans are given up, each with a sentence
    CLEAR = auto()   # plans are given up: they begin at another state
    JUDGE = auto()   # the followed reference is judged at the present state, or stops the loop
    PLACE = auto()   # the set point moves on from the plant; what was in between is not known
    ANEW = auto()    # integral and horizon begin anew
    FADE = auto()    # the command leaves the one that was sent in `transition_time`


Effects = frozenset[Effect]
NO_EFFECTS: Effects = frozenset()


class Switch(NamedTuple):
    """The mode after an event, and the effects."""

    mode: Mode
    effects: Effects = NO_EFFECTS


_I, _W, _S, _R, _P, _Z, _X = Mode
_DROP, _CLEAR, _JUDGE, _PLACE, _ANEW, _FADE = (Effects((each,)) for each in Effect)
_MOVED = _PLACE | _FADE      # a law that goes on at a state that may be another
_BEGIN = _MOVED | _ANEW      # a law that begins

_Row = dict[Mode, Switch]


def _row(**changes: Switch) -> _Row:
    """Return the changes of an event by the first letters of the modes; others change nothing."""
    modes = dict(zip('IWSRPZX', Mode, strict=True))
    of = {letter: change for letters, change in changes.items() for letter in letters}
    return {mode: of.get(letter, Switch(mode)) for letter, mode in modes.items()}


_LOST_TRACK = _row(W=Switch(_W, _CLEAR), SP=Switch(_S, _MOVED | _CLEAR),
                   R=Switch(_R, _MOVED | _JUDGE | _CLEAR), Z=Switch(_Z, _JUDGE | _CLEAR))
_NEW_WORLD = _row(I=Switch(_I, _DROP), WSRPZ=Switch(_W, _DROP), X=Switch(_X, _DROP))

TABLE: dict[Event, _Row] = {
    Event.ACTIVATE: _row(I=Switch(_W), SRPZ=Switch(_W, _DROP)),
    Event.DEACTIVATE: _row(WSRPZ=Switch(_I, _DROP), X=Switch(_X, _DROP)),
    Event.STOP: _row(IWSRPZX=Switch(_X, _DROP)),
    Event.START: _row(X=Switch(_W)),
    Event.STATE: _row(W=Switch(_S, _BEGIN)),
    Event.LOST: _row(WSRP=Switch(_Z, _CLEAR)),
    Event.BACK: _row(Z=Switch(_S, _BEGIN | _JUDGE | _CLEAR)),
    Event.OUTAGE: _LOST_TRACK,
    Event.RESTART: _NEW_WORLD,
    Event.JUMP: _LOST_TRACK,
    Event.REPLACED: _LOST_TRACK,
    Event.FRAME: _NEW_WORLD,
    Event.ADOPT: _row(S=Switch(_S, _FADE), R=Switch(_R, _FADE), P=Switch(_P, _FADE)),
    Event.BEGIN: _row(SRP=Switch(_R, _FADE)),
    Event.END: _row(R=Switch(_S, _FADE)),
    Event.WITHDRAWN: _row(SR=Switch(_S, _BEGIN)),
    Event.PLANNED: _row(S=Switch(_P, _FADE)),
    Event.UNPLANNED: _row(P=Switch(_S, _BEGIN)),
    Event.SUSPEND: _row(SRP=Switch(_Z, _CLEAR)),
    Event.RESUME: _row(Z=Switch(_S, _BEGIN | _JUDGE)),
}


def switch_mode(mode: Mode, event: Event) -> Switch:
    """Return the mode after an event, and the effects."""
    return TABLE[event][mode]
