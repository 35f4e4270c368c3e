# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Arithmetic expressions in text, as a user writes them in a file or a request.

Length, number of symbols and depth of the text are limited before it is parsed. Python's own
parser then builds a tree, in which only numbers, names, + - * / ** and the functions in
``FUNCTIONS`` are accepted. Nothing is evaluated as Python, and every number is a double.
"""

import ast
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
import keyword
import math
import operator
import re
from typing import Any, NamedTuple

import casadi as ca
from obc_ros.core.text.errors import (
    DependentError,
    describe_type,
    quote,
    StatementError,
    suggest_name,
)
from obc_ros.core.text.symbol_guards import LARGER, rewrite_operations, SMALLER

MAX_LENGTH = 20_000   # characters
MAX_SYMBOLS = 4_000   # numbers, names, operators and brackets
MAX_DEPTH = 50        # open brackets, and signs and powers without their operand, together
MAX_NUMBER = 1e100    # squares and products of two such numbers are finite


class _Function(NamedTuple):
    arguments: int
    symbolic: Callable[..., Any]
    numeric: Callable[..., float]


FUNCTIONS: dict[str, _Function] = {
    **{name: _Function(1 + (name == 'atan2'), getattr(ca, name), getattr(math, name)) for name in (
        'sin', 'cos', 'tan', 'asin', 'acos', 'atan', 'atan2', 'sinh', 'cosh', 'tanh', 'exp',
        'log', 'sqrt')},
    'abs': _Function(1, ca.fabs, abs)}
CONSTANTS: dict[str, float] = {'pi': math.pi}
RESERVED_NAMES = frozenset({*FUNCTIONS, *CONSTANTS})

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}
_TOKEN = re.compile(
    r'(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?P<tail>\w*))'
    r'|(?P<name>[A-Za-z_]\w*)|(?P<operator>\*\*|[-+*/])|(?P<bracket>[(),])|(?P<sign>[<>]=?)',
    re.ASCII)
_CHOICE = 'if_'   # if(a < b, c, d), which is no name of Python
# Of a scalar of NumPy in f'{value!r}' or in a list: its type is left out.
_NUMPY = re.compile(r'(?<![\w.])(np\.(?:float|u?int)\d*)\(([^()]*)\)', re.ASCII)
_BEFORE_SIGN = ('(', ',', '+', '-', '*', '/', '**')
_OTHER_SIGNS = {'^': '**', '·': '*', '×': '*', '÷': '/', '−': '-', '–': '-', '²': '**2',
                '³': '**3', '[': '(', '{': '('}
_OTHER_NAMES = {'ln': 'log', 'arcsin': 'asin', 'arccos': 'acos', 'arctan': 'atan',
                'arctan2': 'atan2', 'fabs': 'abs', 'PI': 'pi', 'Pi': 'pi', 'power': '**',
                'pow': '**', 'log10': 'log(...)/log(10)', 'max': '(a + b + abs(a - b))/2',
                'min': '(a + b - abs(a - b))/2', 'hypot': 'sqrt(a**2 + b**2)'}
# The operations of the language of expressions, and what CasADi makes of them.
_KNOWN = {getattr(ca, f'OP_{name}') for name in (
    'ADD', 'SUB', 'MUL', 'DIV', 'POW', 'CONSTPOW', 'NEG', 'SQ', 'TWICE', 'INV', 'SQRT', 'SIN',
    'COS', 'TAN', 'ASIN', 'ACOS', 'ATAN', 'ATAN2', 'SINH', 'COSH', 'TANH', 'EXP', 'LOG', 'FABS',
    'CONST', 'INPUT', 'OUTPUT', 'ASSIGN')}
_IN_WORDS = {ca.OP_FMAX: f'fmax(a, b); write {LARGER}',
             ca.OP_FMIN: f'fmin(a, b); write {SMALLER}',
             ca.OP_SIGN: 'sign(a), nor cbrt(a), which has it; write a/sqrt(a**2 + e**2) with a '
                         'small number e, or a**(1/3) for a positive a',
             ca.OP_FLOOR: 'floor(a), which jumps; state phases, or a smooth function',
             ca.OP_CEIL: 'ceil(a), which jumps; state phases, or a smooth function',
             ca.OP_ASINH: 'asinh(a); write log(a + sqrt(a**2 + 1))',
             ca.OP_ACOSH: 'acosh(a); write log(a + sqrt(a**2 - 1))',
             ca.OP_ATANH: 'atanh(a); write log((1 + a)/(1 - a))/2'}
# What takes the place of operations that have no name in texts.
_REWRITTEN: dict[int, Callable[..., Any]] = {
    ca.OP_HYPOT: lambda a, b: ca.sqrt(a**2 + b**2), ca.OP_LOG1P: lambda a: ca.log(1 + a),
    ca.OP_EXPM1: lambda a: ca.exp(a) - 1}
_COMPARISONS = {getattr(ca, f'OP_{name}') for name in (
    'LT', 'LE', 'EQ', 'NE', 'NOT', 'AND', 'OR', 'IF_ELSE_ZERO')}


class Names(dict[str, ca.SX]):
    """Symbols by name, and a statement's own functions with their numbers of arguments."""

    functions: Mapping[str, tuple[int, Callable[..., ca.SX]]] = {}


def parse_expression(text: object, symbols: Mapping[str, ca.SX], where: str) -> ca.SX:
    """
    Return the scalar CasADi expression of a text or number.

    :param text: Python arithmetic over the names of `symbols`, ``pi`` and ``FUNCTIONS``; or an
        expression in `symbols`, which a Python function returned.
    """
    if isinstance(text, ca.SX):
        return _check_symbolic(text, symbols, where)
    if not isinstance(text, str):
        return ca.SX(_plain_number(text, where))
    return ca.SX(_value(text, _Algebra(symbols), where))


def parse_lifted(text: object, symbols: Mapping[str, ca.SX],
                 where: str) -> tuple[ca.SX, list[tuple[ca.SX, float]]]:
    """
    Return an expression whose numbers are replaced by symbols, and these symbols' values.

    Two texts that differ only in these numbers give the same expression. Numbers in exponents, and
    those of an expression of CasADi, are not replaced.
    """
    literals: list[tuple[ca.SX, float]] = []

    def lift(value: float) -> ca.SX:
        literals.append((ca.SX.sym(f'{where}#{len(literals) + 1}'), value))
        return literals[-1][0]

    if isinstance(text, ca.SX):
        return _check_symbolic(text, symbols, where), []
    if not isinstance(text, str):
        return lift(_plain_number(text, where)), literals
    return ca.SX(_value(text, _Algebra(symbols, lift, lifts=True), where)), literals


def parse_number(text: object, values: Mapping[str, float], where: str) -> float:
    """
    Return the finite number of a text or number.

    ``1e-3``, which YAML reads as text, is a number here.
    """
    if not isinstance(text, str):
        return _plain_number(text, where)
    return _bounded_number(float(_value(text, _Algebra(values, float, 'numeric'), where)), where)


def insert_numbers(text: object, values: Mapping[str, float]) -> str:
    """Return a valid expression, on one line, with numbers in place of some names."""
    def write(token: re.Match[str]) -> str:
        name = token['name']
        return f'({values[name]!r})' if name in values else token[0]

    return ' '.join(_TOKEN.sub(write, _unwrap(str(text))).split())


def check_name(name: object, where: str) -> str:
    """Return `name` if it is a valid name of a state, input or parameter, not a reserved one."""
    if not isinstance(name, str):
        raise StatementError(f'{where}: a name is text, not {describe_type(name)}')
    if len(name) > 64 or not re.fullmatch(r'[A-Za-z_][A-Za-z0-9_]*', name):
        raise StatementError(f"{where}: '{_short(name)}' is not a name; a name has the letters "
                             'a-z, A-Z, digits and _, and does not begin with a digit')
    if keyword.iskeyword(name) or name in RESERVED_NAMES:
        raise StatementError(f"{where}: the name '{name}' is reserved")
    return name


def _check_symbolic(value: ca.SX, symbols: Mapping[str, ca.SX], where: str) -> ca.SX:
    """
    Return an expression, dense, if it is one that a text over the same symbols could state.

    It is not if it contains another symbol, an operation that a text cannot contain, or a number
    that is not finite or too large.
    """
    if value.shape != (1, 1):
        rows, columns = value.shape
        raise StatementError(f'{where}: wanted one expression, found a matrix of {rows} x '
                             f'{columns}')
    value = ca.densify(value)
    known = {symbol.element_hash() for symbol in symbols.values()}
    for symbol in ca.symvar(value):
        if symbol.element_hash() not in known:
            raise StatementError(f"{where}: the symbol '{symbol.name()}' is none of those that "
                                 'the function was called with')
    program = ca.Function('expression', list(symbols.values()), [value])
    if any(program.instruction_id(k) in _REWRITTEN for k in range(program.n_instructions())):
        [value] = rewrite_operations(program, list(symbols.values()), _REWRITTEN)
        program = ca.Function('expression', list(symbols.values()), [value])
    for k in range(program.n_instructions()):
        operation = program.instruction_id(k)
        if operation not in _KNOWN:
            raise StatementError(f'{where}: {_describe_operation(operation)}')
        if operation == ca.OP_CONST:
            number = float(program.instruction_constant(k))
            if not math.isfinite(number):
                raise StatementError(f'{where}: {number} is not a finite number')
            if abs(number) > MAX_NUMBER:
                raise StatementError(f'{where}: {number:g} is too large; numbers up to '
                                     f'{MAX_NUMBER:g} are accepted')
    return value


def _describe_operation(operation: int) -> str:
    if operation in _COMPARISONS:
        return ('comparisons and if_else are not supported, nor numpy.where; write the larger of '
                f'two as {LARGER}, or a smooth function such as (1 + tanh(a/e))/2 for a > 0')
    if operation in _IN_WORDS:
        return f'an expression may not contain {_IN_WORDS[operation]}'
    return ('an operation is not supported; an expression may contain + - * / **, sin, cos, tan, '
            'asin, acos, atan, atan2, sinh, cosh, tanh, exp, log, sqrt and fabs')


def _short(text: str) -> str:
    return quote(text, 40)


def _plain_number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise StatementError(
            f'{where}: wanted a number or an expression, found {describe_type(value)}'
            + ' (YAML reads on, off, yes and no as truth values)' * isinstance(value, bool))
    try:
        result = float(value)
    except OverflowError:
        raise StatementError(f'{where}: the integer is too large for a double') from None
    if not math.isfinite(result):
        raise StatementError(f'{where}: {result} is not a finite number')
    return _bounded_number(result, where)


def _bounded_number(value: float, where: str) -> float:
    if abs(value) > MAX_NUMBER:
        raise StatementError(f'{where}: {value:g} is too large; numbers up to {MAX_NUMBER:g} are '
                             'accepted (write null for no bound)')
    return value


def _parse(text: str, where: str) -> tuple[str, ast.expr]:
    """Return a text on one line, and its tree, if its length, symbols and depth are accepted."""
    if len(text) > MAX_LENGTH:
        raise StatementError(f'{where}: the expression has {len(text)} characters; '
                             f'at most {MAX_LENGTH} are accepted')
    if not text.strip():
        raise StatementError(f'{where}: the expression is empty')
    # Line ends in brackets or in a folded YAML scalar have no meaning.
    text = _unwrap(re.sub(r'[ \t\r\n]+', ' ', text).strip(' '))
    text = re.sub(r'\bif *\(', f'{_CHOICE}(', text)
    _scan(text, where)
    try:
        return text, ast.parse(text, mode='eval').body
    except SyntaxError as error:
        column = max(0, (error.offset or 1) - 1)
        raise StatementError(f"{where}: '{_short(text)}' is not an expression: syntax error near "
                             f"'{_short(text[column:] or 'the end')}'") from None
    except (RecursionError, MemoryError, ValueError):
        raise StatementError(f"{where}: '{_short(text)}' is too complex") from None


def _unwrap(text: str) -> str:
    """Return a text with ``(1.2)`` in place of ``np.float64(1.2)``."""
    return _NUMPY.sub(lambda found: f'({found[2]})', text)


def _scan(text: str, where: str) -> None:
    """
    Check the symbols, their number and the depth of nesting before parsing.

    Versions of Python differ in the depth that they parse; all of them parse ``MAX_DEPTH``.
    """
    position = count = 0
    waiting = [0]  # signs and powers whose operand has not come yet, for each open bracket
    last = '('
    while position < len(text):
        if text[position] == ' ':
            position += 1
            continue
        token = _TOKEN.match(text, position)
        if token is None or token['sign'] and f'{_CHOICE}(' not in text:
            raise StatementError(f'{where}: {_foreign(text, position)}')
        if token['tail']:
            number = token.group().removesuffix(token['tail'])
            instead = f'{number}*{token["tail"]}' if token['tail'][0].isalpha() and float(
                number) else 'decimal digits, and * for a product'
            raise StatementError(f"{where}: '{_short(token.group())}' is not a number; write "
                                 f'{_short(instead)}')
        symbol, position, count = token.group(), token.end(), count + 1
        if symbol == '(':
            waiting.append(0)
        elif symbol == ')':
            waiting = waiting[:-1] or [0]
        elif symbol == '**' or (token['operator'] and last in _BEFORE_SIGN):
            waiting[-1] += 1
        elif token['operator'] or symbol == ',':
            waiting[-1] = 0
        last = symbol
        depth = len(waiting) - 1 + sum(waiting)
        if depth > MAX_DEPTH or count > MAX_SYMBOLS:
            raise StatementError(
                f"{where}: '{_short(text)}' is too complex; at most {MAX_SYMBOLS} symbols and "
                f'{MAX_DEPTH} nested brackets, signs or powers are accepted')


def _foreign(text: str, position: int) -> str:
    """Return a message about the character at `position`, which no expression contains."""
    sign = text[position]
    rest = _short(_cut(text, position))
    if sign in _OTHER_SIGNS:
        return f"'{sign}' in '{rest}' is not understood; write {_OTHER_SIGNS[sign]}"
    if sign in '<>=!':
        return (f"'{sign}' in '{rest}': comparisons and assignments are not supported"
                + '; write the constraint a = b as a - b' * (sign == '='))
    if sign == '.':
        return f"'.' in '{rest}': attributes are not supported; write sin(x), not math.sin(x)"
    if sign.isascii() and sign.isprintable():
        return f"'{sign}' in '{rest}' is not understood"
    return f'the character U+{ord(sign):04X} at {position + 1} is not understood'


def _cut(text: str, position: int) -> str:
    """Return ten characters on each side of a position, and up to ten more that end a word."""
    before = re.search(r'\w{0,10}.{0,10}$', text[max(0, position - 20):position])
    after = re.match(r'.{1,10}\w{0,10}', text[position:])
    return ''.join(found[0] for found in (before, after) if found)


@dataclass
class _Algebra:
    """
    Arithmetic of casadi.SX or of doubles.

    `kind`: field of `_Function`; `lifts`: whether numbers, except in exponents, become symbols.
    """

    names: Mapping[str, Any]
    constant: Callable[[float], Any] = ca.SX
    kind: str = 'symbolic'
    lifts: bool = False

    @property
    def functions(self) -> Mapping[str, _Function]:
        """Return the known functions; `Names` has more of them."""
        own = self.names.functions if isinstance(self.names, Names) else {}
        return FUNCTIONS | {name: _Function(count, call, float)
                            for name, (count, call) in own.items()}


def _is_finite(value: Any) -> bool:
    if isinstance(value, ca.SX):
        return not value.is_constant() or math.isfinite(float(value))
    return isinstance(value, float) and math.isfinite(value)


def _value(text: str, algebra: _Algebra, where: str) -> Any:
    """
    Return the value of an expression; every node of its tree is checked.

    The walk keeps its own stack, because a sum of a thousand terms is a thousand nodes deep.
    """
    text, tree = _parse(text, where)
    exponents = _numbers_in_exponents(tree) if algebra.lifts else set()
    waiting: list[tuple[ast.expr, bool]] = [(tree, False)]
    values: list[Any] = []
    functions = algebra.functions
    while waiting:
        node, ready = waiting.pop()
        piece = _short(text[node.col_offset:node.end_col_offset])
        operands = _operands(node, piece, where, functions)
        if operands and not ready:
            waiting.append((node, True))
            waiting.extend((operand, False) for operand in reversed(operands))
            continue
        arguments = values[len(values) - len(operands):]
        del values[len(values) - len(operands):]
        try:
            value = (ca.SX(float(piece)) if node in exponents
                     else _apply(node, arguments, algebra, where, functions))
            fault = '' if _is_finite(value) else 'is not a finite number'
        except ZeroDivisionError:
            fault = 'divides by zero'
        except OverflowError:
            fault = 'is too large for a double'
        except StatementError as error:   # one of a statement's own function has no place
            if isinstance(error, DependentError) or str(error).startswith(where):
                raise
            raise StatementError(f'{where}: {error}') from None
        except ValueError:
            fault = 'is undefined'
        if fault:
            raise StatementError(f"{where}: '{piece}' {fault}")
        values.append(value)
    return values[0]


def _numbers_in_exponents(tree: ast.expr) -> set[ast.AST]:
    found: set[ast.AST] = set()
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            found.update(part for part in ast.walk(node.right) if isinstance(part, ast.Constant))
            waiting.append(node.left)
        else:
            waiting.extend(ast.iter_child_nodes(node))
    return found


def _operands(node: ast.expr, piece: str, where: str, functions: Mapping[str, _Function]
              ) -> list[ast.expr]:
    """Return the operands of `node`; raise StatementError if it is not arithmetic."""
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        return [node.left, node.right]
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        return [node.operand]
    if isinstance(node, ast.Call):
        if not isinstance(node.func, ast.Name) or node.func.id not in functions:
            name, *known = ('if' if each == _CHOICE else each for each in (
                node.func.id if isinstance(node.func, ast.Name) else piece, *functions))
            raise StatementError(f"{where}: '{_short(name)}' is not a function"
                                 f"{_hint(name, known)}; known functions: {', '.join(known)}")
        wanted = functions[node.func.id].arguments
        if node.func.id == _CHOICE:
            if len(node.args) != wanted or not isinstance(
                    chosen := node.args[0], ast.Compare) or len(chosen.ops) > 1:
                raise StatementError(f"{where}: '{piece.replace(_CHOICE, 'if')}': write "
                                     'if(a < b, c, d)')
            return [chosen.left, *chosen.comparators, *node.args[1:]]
        if len(node.args) != wanted or node.keywords:
            raise StatementError(f"{where}: '{piece}': {node.func.id} takes {wanted} "
                                 f"argument{'s' * (wanted > 1)}")
        return node.args
    if isinstance(node, ast.Name):
        return []
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return []
    raise StatementError(f"{where}: '{piece}' is not arithmetic; an expression consists of "
                         'numbers, names, + - * / **, brackets and functions')


def _apply(node: ast.expr, arguments: list[Any], algebra: _Algebra, where: str,
           functions: Mapping[str, _Function]) -> Any:
    if isinstance(node, ast.BinOp):
        return _BINARY[type(node.op)](*arguments)
    if isinstance(node, ast.UnaryOp):
        return _UNARY[type(node.op)](*arguments)
    if isinstance(node, ast.Call):
        assert isinstance(node.func, ast.Name)
        if len(arguments) > functions[node.func.id].arguments:   # a < b, c, d
            assert isinstance(node.args[0], ast.Compare)
            low, high, *rest = arguments
            less = isinstance(node.args[0].ops[0], ast.Lt | ast.LtE)
            arguments = [high - low if less else low - high, *rest]
        return getattr(functions[node.func.id], algebra.kind)(*arguments)
    if isinstance(node, ast.Constant):
        assert isinstance(node.value, (int, float))
        return algebra.constant(float(node.value))
    assert isinstance(node, ast.Name)
    if node.id in algebra.names:
        return algebra.names[node.id]
    if node.id in CONSTANTS:
        return algebra.constant(CONSTANTS[node.id])
    raise StatementError(_unknown(node.id, algebra.names, where, functions))


def _unknown(name: str, names: Collection[str], where: str, functions: Collection[str]) -> str:
    if name in functions:
        return f"{where}: the function '{name}' needs its argument in brackets"
    hint = _hint(name, [*names, *CONSTANTS])
    if name == 't':
        hint = '; the time is known in dynamics, costs and constraints along the path and at T'
    known = ', '.join(names) or 'none'
    return f"{where}: unknown name '{_short(name)}'{hint}; known names: {_short_list(known)}"


def _hint(name: str, known: Collection[str]) -> str:
    if name in _OTHER_NAMES:
        return f" (did you mean '{_OTHER_NAMES[name]}'?)"
    return suggest_name(name, known)


def _short_list(names: str) -> str:
    return names if len(names) <= 200 else names[:197] + '...'
