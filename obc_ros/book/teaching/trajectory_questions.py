# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Questions of sections 2.1 to 2.3: Examples 2.1 to 2.3, Exercises 2.1 to 2.6."""

from collections.abc import Mapping
import math

import numpy as np
from obc_ros.book.teaching.question import FormulaQuestion
from obc_ros.book.teaching.statements import ExtremalQuestion, ProblemQuestion
from obc_ros.core.numerics.arrays import Array

SIGN = 'the sign: here H = L + lambda f is minimised; with its maximum, lambda changes its sign'
BACKWARDS = ('the sign of the exponent: the costate grows with time, '
             'lambda = lambda(T) e^(a (t - T))')
# Exercise 2.4 with t0 = 0: x' = -a x + b u, J = 1/2 int u^2 + 1/2 c x(T)^2.
SCALAR = {'a': (0.5, 2.0), 'b': (0.5, 2.0), 'c': (0.5, 2.0), 'x0': (0.5, 2.0), 'T': (0.5, 2.0)}
FLAT = {'a': (0.5, 2.0), 'b': (0.5, 2.0), 'x0': (0.5, 2.0), 'xf': (0.5, 2.0), 'T': (0.5, 2.0)}
TIME = {'t': (0.0, 0.5)}
END = 'exp(-a*T)*x0/(1 + b**2*c*(1 - exp(-2*a*T))/(2*a))'   # x(T) of the optimum
LINE = '(x0 + (xf - x0)*t/T)'
# Exercise 2.4 with a = b = c = T = x0 = 1.
STATEMENT = {
    'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': '-x + u'}, 'running_cost': 'u**2/2',
    'terminal_cost': 'x**2/2', 'initial_state': {'x': 1},
    'final_time': {'free': False, 'value': 1}}


def find_end(a: float = 1.0, c: float = 1.0) -> float:
    """Return x(1) of the optimum of Exercise 2.4 with b = T = x(0) = 1."""
    return math.exp(-a) / (1.0 + c * (1.0 - math.exp(-2.0 * a)) / (2.0 * a))


def find_cost(a: float = 1.0, c: float = 1.0) -> float:
    """Return the minimum cost, 1/2 x(0) lambda(0)."""
    return 0.5 * c * find_end(a, c) * math.exp(-a)


def find_extremal(t: Array) -> tuple[Array, Array, Array]:
    """Return x, u and lambda of Exercise 2.4 with a = b = c = T = x(0) = 1."""
    lam = find_end() * np.exp(t - 1.0)
    # x' = -x - lambda with lambda' = lambda
    return (np.exp(-t) - lam[0] * np.sinh(t))[:, None], -lam[:, None], lam[:, None]


def _with(names: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    return {**names, **TIME}


TRAJECTORY_QUESTIONS = (
    FormulaQuestion(
        'example-2.1-minimum', 'Example 2.1: minimise (x1 - a)^2 + (x2 - b)^2 with x1 - x2 = 0. '
        'Give x1 at the minimum.', 'formula of a, b', '(a + b)/2',
        {'a': (-2.0, 2.0), 'b': (-2.0, 2.0)},
        (('a', 'this is the minimum without the constraint'),
         ('(a - b)/2', 'the constraint is x1 = x2, not x1 = -x2')),
        'both gradients vanish in sum: dF/dx + lambda dG/dx = 0, and x1 = x2'),
    FormulaQuestion(
        '2.1-a', 'Exercise 2.1 (a): F = (3, -2, 8) vanishes where G1 = (1, 0, 2) and '
        'G2 = (0, 1, -1) do. Give the numbers l1, l2 with F = l1 G1 + l2 G2.', 'two numbers',
        ((3.0, -2.0),), {},
        ((((-2.0, 3.0),), 'l1 and l2 are exchanged'),),
        'the first two entries of F are l1 and l2'),
    FormulaQuestion(
        '2.1-b', 'Exercise 2.1 (b): for f = (x1 - a)^2 + (x2 - b)^2 and g = x1 - x2, give the '
        'multiplier l with which f + l g has an extremal point at the minimum.',
        'formula of a, b', 'a - b', {'a': (-2.0, 2.0), 'b': (-2.0, 2.0)},
        (('b - a', 'the sign: this is the multiplier of f - l g'),
         ('(a - b)/2', 'the derivative of (x1 - a)^2 is 2 (x1 - a)')),
        'df/dx1 + l dg/dx1 = 0 at x1 = (a + b)/2'),
    FormulaQuestion(
        'example-2.3-time', "Example 2.3: x1' = x2, x2' = u, |u| <= 1. Give the minimum time [s] "
        'from (1, 0) to rest at 0.', 'number', 2.0, {},
        ((math.sqrt(2.0), 'at this time x1 is 0, but x2 is not: the input has to brake'),
         (1.0, 'this is the time of the switch')),
        'accelerate over half of the way, brake over the other half'),
    FormulaQuestion(
        'example-2.3-hamiltonian', 'Example 2.3: T is free. Give the value of '
        'H = 1 + lambda1 x2 + lambda2 u along the optimum.', 'number', 0.0, {},
        ((1.0, 'transversality for a free T: H(T) = 0. You have the condition of another problem, '
          'or left the cost 1 out of H'),
         (-1.0, 'this is the value without the cost L = 1; H contains L')),
        'for a free final time, H(T) = 0, and H is constant'),
    FormulaQuestion(
        '2.2-cost', "Exercise 2.2 (b): q' = u, Y' = q u' - u q'. Give the minimum of "
        "1/2 int u'u dt over [0, 1] for y = (1, 2, 2).", 'number', 3.0 * math.pi, {},
        ((9.0 * math.pi, 'the cost grows with |y|, not with |y|^2'),
         (6.0 * math.pi, 'either the factor 1/2 of the cost is missing, or Y was taken for the '
          'area of the loop; it is twice that')),
        'the loop is a circle: length^2 = 4 pi area, |y| = 2 area, cost = length^2/2'),
    FormulaQuestion(
        '2.2-speed', 'Exercise 2.2 (b): give |u| for y = (1, 2, 2).', 'number',
        math.sqrt(6.0 * math.pi), {},
        ((6.0 * math.pi, 'this is |u|^2'),
         (math.sqrt(12.0 * math.pi), 'Y is twice the area of the loop')),
        '|u| is the length of the circle, which is run through in 1 s'),
    FormulaQuestion(
        '2.3-costate', "Exercise 2.3: minimise int x'^T x' dt over [0, 1] from (0, 0) to (3, 4), "
        "with H = u^T u + lambda u. Give lambda = (lambda1, lambda2).", 'two numbers',
        ((-6.0, -8.0),), {},
        ((((6.0, 8.0),), SIGN),
         (((-3.0, -4.0),), 'dH/du = 2 u + lambda: the factor 2 is missing')),
        'dH/du = 0 for u = (3, 4)'),
    FormulaQuestion(
        '2.4-a-costate', "Exercise 2.4 (a): x' = -a x + b u, J = 1/2 int u^2 + 1/2 c x(T)^2, "
        't0 = 0. Give the costate lambda(t).', 'formula of a, b, c, x0, t, T',
        f'c*exp(a*(t - T))*{END}', _with(SCALAR),
        ((f'-c*exp(a*(t - T))*{END}', SIGN), (f'c*exp(-a*(t - T))*{END}', BACKWARDS)),
        "lambda' = -dH/dx = a lambda, and lambda(T) = c x(T)"),
    FormulaQuestion(
        '2.4-a-input', 'Exercise 2.4 (a): give the optimal input u(t).',
        'formula of a, b, c, x0, t, T', f'-b*c*exp(a*(t - T))*{END}', _with(SCALAR),
        ((f'b*c*exp(a*(t - T))*{END}', 'this input maximises H: u = -b lambda follows from '
          'dH/du = u + b lambda = 0'),
         (f'-c*exp(a*(t - T))*{END}', 'the factor b is missing: dH/du = u + b lambda'),
         (f'-b*c*exp(-a*(t - T))*{END}', BACKWARDS),
         ('-b*c*exp(-a*(t - T))*exp(a*T)*x0/(1 + b**2*c*(exp(2*a*T) - 1)/(2*a))',
          "this solves Example 2.2, x' = a x + b u; here x' = -a x + b u")),
        'u = -b lambda; lambda is the costate of the question before'),
    FormulaQuestion(
        '2.4-a-end', 'Exercise 2.4 (a): give the terminal state x(T).',
        'formula of a, b, c, x0, T', END, SCALAR,
        (('exp(-a*T)*x0', 'this is the state without an input'),
         ('exp(-a*T)*x0/(1 + b**2*c*(1 - exp(-2*a*T))/a)',
          'the integral of e^(-2 a s) over [0, T] has the factor 1/(2 a)'),
         ('exp(-a*T)*x0/(1 + b*c*(1 - exp(-2*a*T))/(2*a))',
          'b occurs twice: in the dynamics and in u = -b lambda'),
         ('exp(a*T)*x0/(1 + b**2*c*(exp(2*a*T) - 1)/(2*a))',
          "this solves Example 2.2, x' = a x + b u; here x' = -a x + b u")),
        "solve x' = -a x - b^2 lambda with x(0) = x0, then set t = T"),
    FormulaQuestion(
        '2.4-a-limit', 'Exercise 2.4 (a): give the limit of x(T) for c to infinity.', 'number',
        0.0, {}, (), 'the larger c is, the more a terminal state other than 0 costs'),
    ExtremalQuestion(
        '2.4-a-extremal', 'Exercise 2.4 (a) with a = b = c = T = x0 = 1: give x(t), u(t) and '
        'lambda(t).', 'keys x, u, lam with formulas of t', STATEMENT),
    ProblemQuestion(
        '2.4-a-problem', 'Exercise 2.4 (a) with a = b = c = T = x0 = 1: state the problem as a '
        'problem file, with the state x and the input u.', 'keys of a problem file',
        find_cost(), find_extremal, 1.0,
        ((2.0 * find_cost(), 'both factors 1/2 of the cost are missing'),
         (find_cost(c=2.0), 'the factor 1/2 of the terminal cost is missing'),
         (2.0 * find_cost(c=0.5), 'the factor 1/2 of the running cost is missing'),
         (find_cost(a=-1.0), "the sign of the dynamics: x' = -a x + b u"))),
    FormulaQuestion(
        '2.4-c-input', 'Exercise 2.4 (c): give the input of the flat trajectory from x0 to xf, '
        'with as few basis functions as possible.', 'formula of a, b, x0, xf, t, T',
        f'((xf - x0)/T + a*{LINE})/b', _with(FLAT),
        ((f'(xf - x0)/T + a*{LINE}', 'the division by b is missing'),
         ('(xf - x0)/(T*b)', "the term a x is missing: u = (x' + a x)/b"),
         (f'((xf - x0)/T - a*{LINE})/b', "the sign of a x: b u = x' + a x")),
        "x is a flat output: u = (x' + a x)/b with a straight line x(t)"),
    FormulaQuestion(
        '2.4-d-cost', 'Exercise 2.4 (d), with a = b = 1, from x(0) = 0 to x(1) = 1: give '
        '1/2 int u^2 of the flat trajectory.', 'number', 7.0 / 6.0, {},
        ((0.5, 'this is the cost of u = 1; the input of the flat trajectory is 1 + t'),),
        'u = 1 + t'),
    FormulaQuestion(
        '2.4-d-optimum', 'Exercise 2.4 (d), with a = b = 1, from x(0) = 0 to x(1) = 1: give the '
        'least 1/2 int u^2.', 'number', 1.0 / (1.0 - math.exp(-2.0)), {},
        ((7.0 / 6.0, 'this is the cost of the flat trajectory'),),
        'u = k e^t with the k for which x(1) = 1'),
    FormulaQuestion(
        '2.5-costate', "Exercise 2.5 (a): x' = -a x^3 + b u. Give lambda' of Pontryagin's "
        'conditions.', 'formula of a, x, lam', '3*a*x**2*lam',
        {'a': (0.5, 2.0), 'x': (-2.0, 2.0), 'lam': (-2.0, 2.0)},
        (('-3*a*x**2*lam', "the sign of the costate equation: lambda' = -dH/dx"),
         ('a*x**2*lam', 'the derivative of x^3 is 3 x^2'),
         ('a*x**3*lam', 'f has to be differentiated by x'),
         ('3*a*x**2', "lambda' is linear in lambda")),
        "lambda' = -dH/dx with H = u^2/2 + lambda (-a x^3 + b u)"),
    FormulaQuestion(
        '2.5-c-input', 'Exercise 2.5 (c): give the input of the flat trajectory from x0 to xf, '
        'with as few basis functions as possible.', 'formula of a, b, x0, xf, t, T',
        f'((xf - x0)/T + a*{LINE}**3)/b', _with(FLAT),
        ((f'((xf - x0)/T + a*{LINE})/b',
          'this is the input for the linear system of Exercise 2.4'),
         (f'(xf - x0)/T + a*{LINE}**3', 'the division by b is missing')),
        "u = (x' + a x^3)/b with a straight line x(t)"),
    FormulaQuestion(
        '2.6-switching', 'Exercise 2.6: give dH/dv, whose sign decides between forward and '
        'reverse.', 'formula of lam1, lam2, theta', 'lam1*cos(theta) + lam2*sin(theta)',
        {'lam1': (-2.0, 2.0), 'lam2': (-2.0, 2.0), 'theta': (-3.0, 3.0)},
        (('lam1*sin(theta) + lam2*cos(theta)', 'sine and cosine are exchanged'),
         ('-lam1*sin(theta) + lam2*cos(theta)', 'this is dH/dtheta over v, not dH/dv'),
         ('lam1*cos(theta*pi/180) + lam2*sin(theta*pi/180)',
          'theta is in radians; you convert from degrees')),
        'H = 1 + lambda1 v cos(theta) + lambda2 v sin(theta) + lambda3 omega'),
    FormulaQuestion(
        '2.6-turn', 'Exercise 2.6: give the minimum time [s] to turn by 90 degrees in place, with '
        'M = 2 rad/s.', 'number', math.pi / 4.0, {},
        ((45.0, 'the angle is in degrees, M in rad/s: wanted radians'),
         (math.pi / 2.0, 'this is the time for M = 1 rad/s')),
        'the angle [rad] over the largest rate'))
