# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Keys of a statement that are Python functions of the problem's symbols.

Such a function is called once, with symbols that have the names of the statement. What it returns
takes its place in the statement: CasADi expressions where a file has texts.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
import inspect
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.text.comparisons import state_row
from obc_ros.core.text.errors import describe_type, quote, StatementError, suggest_name
from obc_ros.core.text.recorded_functions import RecordedFunction
from obc_ros.core.text.symbol_guards import refuse_values

# What the functions take. The first arguments are required, the others follow in this order.
_PATH = (('x', 'u'), ('p', 't'))
_END = (('x',), ('p', 't'))
_START = (('x',), ('p',))
_ARGUMENTS = {
    'dynamics': _PATH, 'running_cost': _PATH, 'path_constraints': _PATH, 'terminal_cost': _END,
    'terminal_constraints': _END, 'initial_cost': _START, 'initial_constraints': _START}
STATED_FUNCTIONS = tuple(_ARGUMENTS)[1:]   # those that need the dynamics first
_LISTS = 'terminal_constraints', 'initial_constraints', 'path_constraints'
# Errors that code of a user may raise; the message quotes their type and text.
_FAULTS = (ArithmeticError, AssertionError, AttributeError, LookupError, NameError,
           NotImplementedError, RuntimeError, TypeError, ValueError)

_Symbols = Mapping[str, ca.SX]


class NamedSymbols:
    """Symbols by name or number: ``x.p``, ``x['p']``, ``x[0]``; iteration yields them in order."""

    __slots__ = ('_symbols', '_what')

    def __init__(self, what: str, symbols: _Symbols) -> None:
        self._what, self._symbols = what, dict(symbols)

    def __getattr__(self, name: str) -> ca.SX:
        if name.startswith('__'):   # of Python or NumPy
            raise AttributeError(name)
        return self[name]

    def __getitem__(self, name: str | int) -> ca.SX:
        if isinstance(name, (int, np.integer)) and not isinstance(name, bool):
            try:
                return tuple(self._symbols.values())[name]
            except IndexError:   # it also ends an iteration by numbers
                raise _NoSymbolError(f'{name} is not the number of {self._what}; there are '
                                     f'{len(self)}, from 0 on') from None
        if not isinstance(name, str) or name not in self._symbols:
            known = ', '.join(self._symbols) or 'none'
            raise StatementError(f"'{quote(str(name))}' is not the name of {self._what}"
                                 f'{suggest_name(str(name), self._symbols)}; there are '
                                 f'{quote(known, 200)}')
        return self._symbols[name]

    def __iter__(self) -> Iterator[ca.SX]:
        return iter(self._symbols.values())

    def __len__(self) -> int:
        return len(self._symbols)

    def _refuse(self, *operands: object) -> Any:
        letter = {'an input': 'u', 'a parameter': 'p'}.get(self._what, 'x')
        name = next(iter(self._symbols), 'name')
        raise StatementError(f'{letter} has names, it is no number: write {letter}.{name}, '
                             f"{letter}['{name}'] or {letter}[0]; numpy.array({letter}) is the "
                             'array of all')

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = _refuse
    __rtruediv__ = __pow__ = __rpow__ = __neg__ = __abs__ = __call__ = __float__ = _refuse
    __lt__ = __le__ = __gt__ = __ge__ = __eq__ = __ne__ = __bool__ = __matmul__ = _refuse


def call_functions(given: Mapping[Any, Any], keys: Collection[str], x: _Symbols, u: _Symbols,
                   p: _Symbols, t: ca.SX | None) -> dict[Any, Any]:
    """
    Return a statement in which functions are replaced by what they return.

    :param keys: the keys that may be functions: 'dynamics' or `STATED_FUNCTIONS`.
    :param t: the time; None if its name has another meaning.
    """
    symbols = {'x': NamedSymbols('a state', x), 'u': NamedSymbols('an input', u),
               'p': NamedSymbols('a parameter', p), 't': t}
    found = dict(given)
    for key in keys:
        value = given.get(key)
        if isinstance(value, RecordedFunction):
            found[key] = value.evaluate({**x, **u, **p} | ({} if t is None else {'t': t}))
        elif callable(value):
            found[key] = _arrange(key, _call(key, value, symbols), tuple(x))
    return found


def call_with_symbols(function: Callable[..., Any], *symbols: Any) -> Any:
    """
    Return what a function of the user returns for CasADi symbols.

    :raises StatementError: if the function needs the value of a symbol, as one of math does.
    """
    with refuse_values():
        return function(*symbols)


class _NoSymbolError(StatementError, IndexError):
    """No symbol has a number."""


def _call(key: str, function: Callable[..., Any], symbols: Mapping[str, Any]) -> object:
    letters = _choose_arguments(key, function)
    if 't' in letters and symbols['t'] is None:
        raise StatementError(f"{key}: the function takes the time, but the statement gives the "
                             "name 't' another meaning")
    try:
        found = call_with_symbols(function, *(symbols[letter] for letter in letters))
    except StatementError as error:
        raise StatementError(f'{key}: {error}') from None
    except _FAULTS as error:
        if isinstance(error.__cause__, StatementError):   # NumPy raises one of its own then
            raise StatementError(f'{key}: {error.__cause__}') from None
        words = quote(' '.join(str(error).split()), 200)
        raise StatementError(f'{key}: the function raised {type(error).__name__}: {words}; '
                             'it is called with CasADi symbols') from error
    if found is None:
        raise StatementError(f'{key}: the function returned nothing')
    return found


def _choose_arguments(key: str, function: Callable[..., Any]) -> tuple[str, ...]:
    """Return what a function is called with: by the names x, u, p, t, else by position."""
    required, more = _ARGUMENTS[key]
    try:
        names = tuple(each.name for each in inspect.signature(function).parameters.values()
                      if each.default is each.empty and each.kind in (
                          each.POSITIONAL_ONLY, each.POSITIONAL_OR_KEYWORD))
    except (TypeError, ValueError):   # a builtin has no signature
        names = ()
    wanted = f'{key}: wanted a function of {", ".join(required)} (and {", ".join(more)} if needed)'
    if names and set(names) <= set('xupt'):
        if unknown := [name for name in names if name not in required + more]:
            raise StatementError(f"{wanted}, found one of '{unknown[0]}'")
        return names
    if not len(required) <= len(names) <= len(required + more):
        raise StatementError(
            f'{wanted}, found one of {len(names)} argument{"s" * (len(names) != 1)}')
    letters = (required + more)[:len(names)]
    for name, letter in zip(names, letters, strict=True):
        if name in set('xupt') - {letter}:
            raise StatementError(f"{wanted}, found '{name}' in the place of {letter}, beside "
                                 'other names: name all arguments x, u, p, t, or none')
    return letters


def _arrange(key: str, value: object, states: tuple[str, ...]) -> object:
    """Return what a function returned in the form that the key has in a file."""
    if key == 'dynamics':
        if isinstance(value, Mapping):
            return {name: _plain(each) for name, each in value.items()}
        rows = _rows(value)
        if rows is None:
            raise StatementError('dynamics: the function returned '
                                 f'{describe_type(value)}; wanted an expression for each state')
        if len(rows) != len(states):
            raise StatementError(f'dynamics: the function returned {len(rows)} expressions for '
                                 f'{len(states)} states')
        return dict(zip(states, rows, strict=True))
    if key in _LISTS:
        alone = isinstance(value, tuple) and len(value) == 3 and not any(
            isinstance(each, ca.SX) for each in value[1:])   # (expression, lower, upper)
        rows = _rows([value] if alone else value)
        return value if rows is None else [_arrange_row(key, row, f'{key}[{k}]')
                                           for k, row in enumerate(rows)]
    return _plain(value)


def _arrange_row(key: str, row: Any, where: str) -> Any:
    stated = state_row(key, row, where)
    return {name: _plain(each) for name, each in stated.items()} if isinstance(
        stated, Mapping) else stated


def _rows(value: object) -> list[Any] | None:
    """Return the entries of a list or of a column."""
    if isinstance(value, ca.SX) and value.is_column():
        return list(ca.vertsplit(value)) if value.numel() else []
    if isinstance(value, np.ndarray) and value.ndim == 1:
        return [_plain(each) for each in value.tolist()]
    return [_plain(each) for each in value] if isinstance(value, (list, tuple)) else None


def _plain(value: object) -> object:
    """Return a number of NumPy or CasADi as one of Python."""
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.size == 1):
        return value.item()
    if isinstance(value, ca.DM) and value.shape == (1, 1):
        return float(value)
    return value
