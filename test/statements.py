# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A statement with every key, its malformed variants, and the error of each."""

import copy
import math

GOOD = {
    'name': 'lander',
    'title': 'for people',
    'states': ['h', 'v'],
    'inputs': ['u'],
    'parameters': {'g': 1.5, 'weight': '2*g', 'top': '1e1'},
    'dynamics': {'h': 'v', 'v': '-g + u'},
    'running_cost': 'u',
    'terminal_cost': 'weight*v**2',
    'initial_state': {'h': 'top', 'v': -2},
    'terminal_constraints': ['h - 1'],
    'input_bounds': {'u': [0, '2*g']},
    'state_bounds': {'h': [0, None]},
    'path_constraints': [{'expr': 'h + v*u', 'lower': '-top', 'upper': None}],
    'final_time': {'free': True, 'lower': 0.1, 'upper': 20, 'guess': 4},
    'initial_guess': {'states': {'h': [10, 0]}, 'inputs': {'u': 'g'}, 'final_time': 5},
}


def changed(path, value, statement=GOOD):
    """Return a statement with the entry at a dotted path replaced, or omitted if it is `...`."""
    mapping = copy.deepcopy(statement)
    *parents, last = path.split('.')
    inner = mapping
    for key in parents:
        inner = inner[int(key) if isinstance(inner, list) else key]
    if value is ...:
        del inner[last]
    else:
        inner[int(last) if isinstance(inner, list) else last] = value
    return mapping


FAULTS = [
    # Keys and types
    ('runing_cost', 'u', r"^runing_cost: unknown key \(did you mean 'running_cost'\?\)"),
    ('final_state', {'x': 0}, r"^final_state: .* \(did you mean 'terminal_constraints'\?\)"),
    ('horizon', 3, r"^horizon: unknown key \(did you mean 'final_time'\?\)$"),
    ('colour', 3, '^colour: unknown key; known keys: name, system, states, inputs, '),
    ('states', ..., '^states: missing'),
    ('states', 'h', "^states: wanted a list, found str 'h'"),
    ('states', {'h': 1}, '^states: wanted a list, found a mapping'),
    ('states', [], '^states: the list is empty'),
    ('states', ['h', 'v', 'h'], "^states: 'h' occurs twice"),
    ('states', ['h', 3], '^states: a name is text'),
    ('states', ['h', True], '^states: a name is text'),
    ('states', ['h', 'v v'], "^states: 'v v' is not a name"),
    ('states', ['h', 'sin'], "^states: the name 'sin' is reserved"),
    ('states', ['h', 'pi'], "^states: the name 'pi' is reserved"),
    ('states', ['h', 'lambda'], "^states: the name 'lambda' is reserved"),
    ('states', ['h', ['v']], '^states: a name is text'),
    ('inputs', ['v'], "^inputs: 'v' is both a state and an input"),
    ('name', ['a'], '^name: '),
    # Parameters
    ('parameters.h', 1, "^parameters: 'h' is both a parameter and a state"),
    ('parameters.u', 1, "^parameters: 'u' is both a parameter and an input"),
    ('parameters.cos', 1, "^parameters: the name 'cos' is reserved"),
    ('parameters.g', math.nan, r'^parameters\.g: nan is not a finite'),
    ('parameters.g', math.inf, r'^parameters\.g: inf is not a finite'),
    ('parameters.g', True, r'^parameters\.g: wanted a number or an expression, found bool'),
    ('parameters.g', None, r'^parameters\.g: .* found nothing'),
    ('parameters.g', [1], r'^parameters\.g: .* found a list'),
    ('parameters.g', 'top', r"^parameters\.g: unknown name 'top'"),
    ('parameters.g', 'h', r"^parameters\.g: unknown name 'h'"),
    ('parameters.g', '1/0', r"^parameters\.g: '1/0' divides by zero"),
    ('parameters', [1], '^parameters: wanted a mapping'),
    # Dynamics and costs
    ('dynamics', ..., '^dynamics: missing'),
    ('dynamics.v', ..., "^dynamics: no equation for the state 'v'"),
    ('dynamics.w', 'u', r"^dynamics\.w: 'w' is not a state"),
    ('dynamics.u', 'u', r"^dynamics\.u: 'u' is not a state"),
    ('dynamics.v', 'gg + u', r"^dynamics\.v: unknown name 'gg' \(did you mean 'g'\?\)"),
    ('input_bounds.u', [0, 't'], r"^input_bounds\.u \(upper\): unknown name 't'; the time is"),
    ('dynamics.v', ['u'], r'^dynamics\.v: .* found a list'),
    ('dynamics.v', True, r'^dynamics\.v: .* found bool'),
    ('dynamics.v', None, r'^dynamics\.v: .* found nothing'),
    ('dynamics.v', math.inf, r'^dynamics\.v: inf'),
    ('dynamics', ['v', 'u'], '^dynamics: wanted a mapping'),
    ('dynamics.v', 'u/(h - 10)', r'^dynamics\.v: undefined at the initial state \(h = 10'),
    ('dynamics.v', 'sqrt(v)*u', r'^dynamics\.v: undefined at the initial state'),
    ('dynamics.v', 'u + log(h - top)', r'^dynamics\.v: undefined at the initial state'),
    ('running_cost', 'u**2/(h - 10)', '^running_cost: undefined at the initial state'),
    ('running_cost', 'x', "^running_cost: unknown name 'x'"),
    ('running_cost', {'u': 1}, '^running_cost: .* found a mapping'),
    ('terminal_cost', 'u', "^terminal_cost: 'u' is an input"),
    ('terminal_cost', 'h +', "^terminal_cost: 'h \\+' is not an expression"),
    # Terminal conditions
    ('initial_state', ..., '^initial_state: missing'),
    ('initial_state', [10, -2, 3], '^initial_state: wanted a number for each state'),
    ('initial_state.v', ..., "^initial_state: no value for the state 'v'"),
    ('initial_state.w', 1, r"^initial_state\.w: 'w' is not a state"),
    ('initial_state.v', math.nan, r'^initial_state\.v: nan'),
    ('initial_state.v', 'h', r"^initial_state\.v: unknown name 'h'"),
    ('terminal_constraints', 'h', '^terminal_constraints: wanted a list'),
    ('terminal_constraints', {'h': 1}, '^terminal_constraints: wanted a list'),
    ('terminal_constraints.0', 'u', r"^terminal_constraints\[0\]: 'u' is an input"),
    ('terminal_constraints.0', 'h - z', r"^terminal_constraints\[0\]: unknown name 'z'"),
    ('terminal_constraints.0', 0, r"^terminal_constraints\[0\]: '0' does not depend"),
    ('terminal_constraints.0', 'g', r"^terminal_constraints\[0\]: 'g' does not depend"),
    ('terminal_constraints.0', None, r'^terminal_constraints\[0\]: .* found nothing'),
    ('terminal_constraints.0', 'h/0', r'^terminal_constraints\[0\]: .* finite'),
    # Bounds
    ('input_bounds.u', [3, 0], r'^input_bounds\.u: the bounds cross: lower 3 > upper 0'),
    ('input_bounds.u', [0, '-g'], r'^input_bounds\.u: the bounds cross'),
    ('input_bounds.u', [0], r'^input_bounds\.u: wanted \[lower, upper\], found 1'),
    ('input_bounds.u', [0, 1, 2], r'^input_bounds\.u: wanted \[lower, upper\], found 3'),
    ('input_bounds.u', 3, r'^input_bounds\.u: wanted \[lower, upper\], found int'),
    ('input_bounds.u', [math.nan, 1], r'^input_bounds\.u \(lower\): nan'),
    ('input_bounds.u', [0, math.inf], r'^input_bounds\.u: upper bound inf: write null'),
    ('input_bounds.u', [0, 'v'], r"^input_bounds\.u \(upper\): unknown name 'v'"),
    ('input_bounds.v', [0, 1], r"^input_bounds\.v: 'v' is not an input"),
    ('input_bounds', [[0, 1]], '^input_bounds: wanted a mapping'),
    ('state_bounds.u', [0, 1], r"^state_bounds\.u: 'u' is not a state"),
    ('state_bounds.h', [1, 0], r'^state_bounds\.h: the bounds cross'),
    ('path_constraints', {'expr': 'h', 'upper': 1},
     r'^path_constraints: wanted a list, .*; write \[\{expr: h, upper: 1\}\]$'),
    ('path_constraints', 'v <= 1', r"^path_constraints: .*'v <= 1'; write \[v <= 1\]$"),
    ('path_constraints', {'v': 1}, '^path_constraints: wanted a list, found a mapping$'),
    ('initial_state.h', True, r'^initial_state\.h: .* \(YAML reads on, off, yes and no as'),
    ('path_constraints.0', 'h', r'^path_constraints\[0\]: wanted a mapping'),
    ('path_constraints.0.expr', ..., r'^path_constraints\[0\]: expr is missing'),
    ('path_constraints.0.expr', 'q', r"^path_constraints\[0\]\.expr: unknown name 'q'"),
    ('path_constraints.0.expr', 'g', r'^path_constraints\[0\]\.expr: depends on no state'),
    ('path_constraints.0.lower', ..., r'^path_constraints\[0\]: wanted a lower or an upper'),
    ('path_constraints.0.upper', -11, r'^path_constraints\[0\]: the bounds cross'),
    ('path_constraints.0.max', 1, r'^path_constraints\[0\]\.max: unknown key'),
    ('path_constraints.0.expr', 'log(-h)', r'^path_constraints\[0\]: undefined at the initial'),
    # Final time
    ('final_time', ..., '^final_time: missing'),
    ('final_time', [3], '^final_time: wanted {free: false, value: 5} or'),
    ('final_time', -3, '^final_time.value: a final time is > 0'),
    ('final_time.free', ..., '^final_time.free: wanted true or false, found nothing; write {f'),
    ('final_time', {'value': 'pi/2'}, r'^final_time\.free: wanted true or false, found nothing; '
                                      r'write {free: false, value: pi/2}$'),
    ('final_time.free', 'yes', r'^final_time\.free: wanted true or false'),
    ('final_time.free', 1, r'^final_time\.free: wanted true or false'),
    ('final_time', {'free': False, 'value': 0}, r'^final_time\.value: .* > 0, found 0'),
    ('final_time', {'free': False, 'value': -1}, r'^final_time\.value: .* > 0, found -1'),
    ('final_time', {'free': False, 'value': math.nan}, r'^final_time\.value: nan'),
    ('final_time', {'free': False}, r'^final_time\.value: missing'),
    ('final_time', {'free': False, 'value': 1, 'lower': 1}, r'^final_time\.lower: .* given'),
    ('final_time.value', 3, r'^final_time\.value: the final time is free'),
    ('final_time.upper', ..., r'^final_time\.upper: missing'),
    ('final_time.upper', 0.05, '^final_time: the bounds cross'),
    ('final_time.upper', 0, r'^final_time\.upper: .* > 0'),
    ('final_time.lower', -1, r'^final_time\.lower: -1 is negative'),
    ('final_time.guess', 0, r'^final_time\.guess: .* > 0'),
    ('final_time.maximum', 9, r'^final_time\.maximum: unknown key'),
    # Guess
    ('initial_guess', [1], '^initial_guess: wanted a mapping'),
    ('initial_guess.x', {}, r'^initial_guess\.x: unknown key'),
    ('initial_guess.states', [1], r'^initial_guess\.states: wanted a mapping'),
    ('initial_guess.states.w', 1, r"^initial_guess\.states\.w: 'w' is not one of the states"),
    ('initial_guess.states.h', [], r'^initial_guess\.states\.h: the list is empty'),
    ('initial_guess.states.h', [1, math.nan], r'^initial_guess\.states\.h: nan'),
    ('initial_guess.inputs.u', {'a': 1}, r'^initial_guess\.inputs\.u: .* found a mapping'),
    ('initial_guess.final_time', -1, r'^initial_guess\.final_time: .* > 0'),
    ('starts', {'states': {'h': 1}}, '^starts: wanted a list, found a mapping'),
    ('starts', [{}, 3], r'^starts\[1\]: wanted a mapping'),
    ('starts', [{'states': {'w': 1}}], r"^starts\[0\]\.states\.w: 'w' is not one of the states"),
    ('starts', [{'inputs': {'u': []}}], r'^starts\[0\]\.inputs\.u: the list is empty'),
    # Systems
    ('system', 'aircraft', '^states: the system defines it already'),
]
