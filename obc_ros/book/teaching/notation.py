# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The notation of answers in a sheet: that of the sheet itself, as students write it.

``q^2``, ``2q``, ``2 q``, ``(a + b)(a - b)``, ``e^(-a T)``, ``sqrt`` and ``pi`` as signs, ``K =``
before an answer, ``2.0 s``, rows in text such as ``(1, 2)``, and ``-1 + 2j``. What can be read in
two ways, such as ``1/2q``, is refused. Nothing of this holds for problem files, which have one
notation.
"""

from collections.abc import Collection, Mapping, Sequence
import math
import re
from typing import Any, NamedTuple

import casadi as ca
from obc_ros.core.text.errors import quote, StatementError
from obc_ros.core.text.expressions import (
    FUNCTIONS,
    MAX_LENGTH,
    parse_expression,
    parse_number,
)

_SIGNS = str.maketrans({
    '·': '*', '⋅': '*', '×': '*', '∗': '*', '÷': '/', '−': '-', '–': '-',
    '²': '^(2)', '³': '^(3)', 'λ': 'lam', 'θ': 'theta',
    **{chr(0x2080 + digit): str(digit) for digit in range(10)}})   # indices
_NAMES = {'ln': 'log', 'arcsin': 'asin', 'arccos': 'acos', 'arctan': 'atan'}
# The unit of the sheet and a factor to it.
_UNITS: Mapping[str, tuple[str, str]] = {
    'rad/s': ('rad/s', ''), '1/s': ('rad/s', ''), 'm/s': ('m/s', ''), 'rad': ('rad', ''),
    'degrees': ('rad', '*pi/180'), 'deg': ('rad', '*pi/180'), '°': ('rad', '*pi/180'),
    '%': ('', '/100'), 's': ('s', ''), 'm': ('m', '')}
_PREFIX = re.compile(r"\s*[A-Za-z_λθ]\w{0,63}[*']{0,2}\s*(?:\([\w ,]{0,20}\))?\s*=", re.ASCII)
_TOKEN = re.compile(
    r'(?P<space>[ \t\r\n]*)(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)'
    r'|(?P<name>π|[A-Za-z_]\w*)|(?P<sign>\*\*|[-+*/^√])|(?P<opened>[(\[{])|(?P<closed>[)\]}])'
    r'|(?P<comma>,))', re.ASCII)
_IMAGINARY = re.compile(r'(?<![A-Za-z_])[ij](?![A-Za-z_])', re.ASCII)
_DECIMAL_COMMA = re.compile(
    rf'\s*[-+]?(\d+),(\d+)\s*(?:{"|".join(map(re.escape, _UNITS))})?\s*', re.ASCII)


def find_unit(text: str) -> str:
    """Return the unit that a question asks for, as in ``the time [s]``; '' if it names none."""
    found = re.search(r'\[(s|m|m/s|rad|rad/s)\]', text)
    return found[1] if found else ''


def has_complex(answer: Any) -> bool:
    """Return whether an answer without names has a complex number in an entry."""
    return bool(split_answer(answer, True, '') != split_answer(answer, False, ''))


def split_answer(answer: Any, numeric: bool, where: str) -> Any:
    """
    Return an answer as lists of entries, where a text has rows; other answers as they are.

    :param numeric: whether it has no names, so that j is the imaginary unit; a complex number is
        a row of its real and imaginary part, and the larger imaginary part comes first.
    """
    if isinstance(answer, str) and len(answer) <= MAX_LENGTH:
        found = _split(answer, where)
    elif isinstance(answer, (list, tuple)):
        found = [_split(each, where) if isinstance(each, str) and len(each) <= MAX_LENGTH
                 else each for each in answer]
        if any(isinstance(each, list) for each in found) and '±' in str(answer):
            found = [part for each in found
                     for part in (each if isinstance(each, list) else [each])]
    else:
        return answer
    entries = found if isinstance(found, list) else [found]
    texts = [each for each in entries if isinstance(each, str)]
    if numeric and len(entries) <= 10 and any(map(_IMAGINARY.search, texts)):
        numbers = [_read_complex(each, where) for each in entries]
        return sorted(([each.real, each.imag] for each in numbers), key=lambda each: -each[1])
    return found


def parse_answer(text: Any, symbols: Mapping[str, ca.SX], where: str, unit: str = '') -> ca.SX:
    """
    Return the expression of an entry in the notation of problem files or of a sheet.

    :raises StatementError: if it is neither, can be read in two ways, or has another unit.
    """
    try:
        return parse_expression(text, symbols, where)
    except StatementError:
        if not isinstance(text, str) or len(text) > MAX_LENGTH:
            raise
        plain = write_plainly(text, symbols, where, unit)
        if plain == text:
            raise
    return parse_expression(plain, symbols, where)


def write_plainly(text: str, names: Collection[str], where: str, unit: str = '') -> str:
    """Return a text of a sheet in the notation of problem files."""
    text, name = _cut_unit(_drop_prefix(text), names)
    text = text.translate(_SIGNS)
    if 'x0' in names:
        text = re.sub(r'\bx ?\(0\)', 'x0', text, flags=re.ASCII)
    text = _Writer(names, where).write(text)
    kind, factor = _UNITS.get(name, (unit, ''))
    if kind != unit:
        raise StatementError(f'{where}: the answer is in {name}, ' + (
            f'wanted {unit}' if unit else 'but no unit is asked for'))
    return f'({text}){factor}' if factor else text


def _drop_prefix(text: str) -> str:
    """Return the right side of ``K = ...``."""
    found = _PREFIX.match(text)
    return text[found.end():].strip(' ') if found and '=' not in text[found.end():] else text


def _cut_unit(text: str, names: Collection[str]) -> tuple[str, str]:
    """Return a text without the unit at its end, and this unit; '' if there is none."""
    whole = text.rstrip(' ')
    for name in _UNITS:
        value = whole.removesuffix(name).rstrip(' ')
        apart = len(value) + len(name) < len(whole)
        if (not whole.endswith(name) or name in names or not value or value[-1] in '+-*/^(,='
                or (not apart and re.search(r'(?<!\w)[A-Za-z_]\w*$', value[-70:], re.ASCII))):
            continue
        return value, name
    return text, ''


def _split(text: str, where: str, level: int = 2) -> Any:
    """Return the entries of ``[a, b]``, ``(a, b)`` or ``a, b``; the text if it is one entry."""
    text = _drop_prefix(text)
    if found := _DECIMAL_COMMA.fullmatch(text):
        raise StatementError(f"{where}: '{quote(text)}' can be read in two ways; write "
                             f'{found[1]}.{found[2]}, or [{found[1]}, {found[2]}] for two numbers')
    inner = text.strip(' \t\r\n')
    is_row = False
    if level and inner and inner[0] in '([' and _close(inner) == len(inner) - 1:
        # `[[0], [5]]` and `[[1, 2]]` have rows of one entry and one row; (a) is only a.
        is_row = inner[0] == '[' and (level == 1 or inner[1:].lstrip().startswith('[')
                                      and _close(inner[1:-1].strip()) == len(
                                          inner[1:-1].strip()) - 1)
        inner = inner[1:-1]
    parts = _cut_at_commas(inner) if level else [text]
    if len(parts) > 1 or is_row:
        return [_split(part, where, level - 1) for part in parts]
    return [text.replace('±', sign) for sign in '+-'] if text.count('±') == 1 else text


def _close(text: str) -> int:
    """Return the index of the bracket that closes the first one; -1: none."""
    depth = 0
    for index, sign in enumerate(text):
        depth += (sign in '([{') - (sign in ')]}')
        if not depth:
            return index
    return -1


def _cut_at_commas(text: str) -> list[str]:
    """Return the parts of a text between the commas outside of brackets."""
    cuts, depth = [-1], 0
    for index, sign in enumerate(text):
        depth += (sign in '([{') - (sign in ')]}')
        if sign == ',' and depth == 0:
            cuts.append(index)
    return [text[begin + 1:end] for begin, end in zip(cuts, [*cuts[1:], len(text)], strict=True)]


def _read_complex(entry: Any, where: str) -> complex:
    """Return the number of a text that is linear in the imaginary unit."""
    text = write_plainly(_IMAGINARY.sub(' (j)', str(entry)), ['j'], where)
    at = [parse_number(text, {'j': float(value)}, where) for value in (0, 1, 2)]
    if not math.isclose(at[2] - at[1], at[1] - at[0], rel_tol=1e-9, abs_tol=1e-9):
        raise StatementError(f"{where}: '{quote(str(entry))}' is not a complex number such as "
                             '-1 + 2j')
    return complex(at[0], at[1] - at[0])


class _Piece(NamedTuple):
    """A token; `apart`: whether there is space before it."""

    kind: str
    text: str
    apart: bool


class _Writer:
    """
    Writes the products that are not written, and the signs of the sheet.

    `_before` has, for each open bracket, the sign before the operand that ends here, and whether
    it is the exponent of e; `_divided` whether this operand belongs to a denominator; `_bare`
    whether it is a single number or name.
    """

    def __init__(self, names: Collection[str], where: str) -> None:
        self.names, self.where = names, where
        self._before: list[tuple[str, bool]] = [('', False)]
        self._divided = [False]
        self._bare = False
        self._out: list[str] = []

    def write(self, text: str) -> str:
        """Return a text with every product and the signs of problem files."""
        pieces = self._tokenize(text)
        last = _Piece('', '', False)
        for index, piece in enumerate(pieces):
            following = pieces[index + 1] if index + 1 < len(pieces) else _Piece('', '', False)
            if self._is_product(last, piece):
                self._refuse_two_readings(last, piece)
                self._out.append('*')
                self._before[-1] = ('*', False)
            elif piece.apart:
                self._out.append(' ')
            self._add(piece, last, following)
            last = piece
        return ''.join(self._out).strip(' ')

    def _is_product(self, left: _Piece, right: _Piece) -> bool:
        if left.kind not in ('number', 'name', 'closed'):
            return False
        if right.kind == 'number':
            return left.kind == 'closed'
        if right.text == '√':
            return True
        if left.kind == 'name' and right.kind == 'opened':
            return left.text in self.names or left.text in ('pi', 'π', 'e')
        return right.kind in ('name', 'opened')

    def _refuse_two_readings(self, left: _Piece, right: _Piece) -> None:
        sign, exponential = self._before[-1]
        joined = not right.apart and right.kind != 'opened'
        if self._divided[-1]:
            sign = sign if sign == '/' else f'/ ... {sign}'
        elif not self._bare or not (
                sign == '^' and (exponential or not right.apart) or sign == '√' and joined):
            return
        raise StatementError(
            f"{self.where}: '{sign}{quote(left.text, 20)}{' ' * right.apart}"
            f"{quote(right.text, 20)}' can be read in two ways; write * and brackets")

    def _add(self, piece: _Piece, last: _Piece, following: _Piece) -> None:
        text = piece.text
        if piece.kind == 'sign':
            self._add_sign(text, last, following)
        elif piece.kind == 'opened':
            self._before.append(('', False))
            self._divided.append(False)
            self._out.append('(')
        elif piece.kind == 'closed':
            self._before = self._before[:-1] or [('', False)]
            self._divided = self._divided[:-1] or [False]
            self._bare = False
            self._out.append(')')
        elif piece.kind == 'name':
            self._bare = True
            self._out.append(self._translate(text, following))
        else:
            self._bare = True
            self._out.append(text)
        if last.text == '√' and piece.kind != 'opened':
            self._out.append(')')

    def _add_sign(self, text: str, last: _Piece, following: _Piece) -> None:
        if text == '√':
            if following.kind not in ('number', 'name', 'opened') or (
                    following.text in FUNCTIONS):
                raise StatementError(f'{self.where}: put what is under the root in brackets')
            self._before[-1] = ('√', False)
            self._out.append('sqrt' if following.kind == 'opened' else 'sqrt(')
            return
        power = text in ('^', '**')
        if last.kind in ('number', 'name', 'closed'):   # not the sign of an operand
            self._before[-1] = ('^' if power else text, power and last.text == 'e')
            self._divided[-1] = text == '/' or power and self._divided[-1]
        self._out.append('**' if power else text)

    def _translate(self, name: str, following: _Piece) -> str:
        """Return a name as problem files have it."""
        if name in self.names:
            return name
        short = name.replace('lambda', 'lam').replace('_', '')
        if short in self.names:
            return short
        name = _NAMES.get(name, name)
        if name in FUNCTIONS and following.kind != 'opened':
            raise StatementError(f'{self.where}: put the argument of {name} in brackets')
        return {'e': 'exp(1)', 'π': 'pi'}.get(name, name)

    def _tokenize(self, text: str) -> Sequence[_Piece]:
        pieces, position = [], 0
        text = text.rstrip(' \t\r\n')
        while position < len(text):
            found = _TOKEN.match(text, position)
            if not found or found.lastgroup is None:
                sign = text[position:].lstrip(' \t\r\n')[0]
                raise StatementError(f'{self.where}: ' + (
                    f"'{sign}'" if sign.isprintable() else f'the character U+{ord(sign):04X}')
                    + ' is not understood')
            pieces.append(_Piece(found.lastgroup, found[found.lastgroup], bool(found['space'])))
            position = found.end()
        return pieces
