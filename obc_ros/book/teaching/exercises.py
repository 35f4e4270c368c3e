# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Questions on the exercises and examples, from minimisation to receding horizons."""

from collections.abc import Mapping
import math
from math import sqrt

import numpy as np
from obc_ros.book.teaching.question import (
    ExtremalQuestion,
    FormulaQuestion,
    ProblemQuestion,
    SheetQuestion,
)
from obc_ros.core.numerics.arrays import Array

SIGN = 'the sign: here H = L + lambda f is minimised; with its maximum, lambda changes its sign'
BACKWARDS = ('the sign of the exponent: the costate grows with time, '
             'lambda = lambda(T) e^(a (t - T))')
# Exercise 2.4 with t0 = 0: x' = -a x + b u, J = 1/2 int u^2 + 1/2 c x(T)^2.
SCALAR = {'a': (0.5, 2.0), 'b': (0.5, 2.0), 'c': (0.5, 2.0), 'x0': (0.5, 2.0), 'T': (0.5, 2.0)}
FLAT = {'a': (0.5, 2.0), 'b': (0.5, 2.0), 'x0': (0.5, 2.0), 'xf': (0.5, 2.0), 'T': (0.5, 2.0)}
EARLY = {'t': (0.0, 0.5)}
END = 'exp(-a*T)*x0/(1 + b**2*c*(1 - exp(-2*a*T))/(2*a))'   # x(T) of the optimum
LINE = '(x0 + (xf - x0)*t/T)'
# Exercise 2.4 with a = b = c = T = x0 = 1.
STATEMENT = {
    'states': ['x'], 'inputs': ['u'], 'dynamics': {'x': '-x + u'}, 'running_cost': 'u**2/2',
    'terminal_cost': 'x**2/2', 'initial_state': {'x': 1},
    'final_time': {'free': False, 'value': 1}}
POSITION_WEIGHT = {'q': (0.2, 5.0)}
PLANT = {'a': (0.5, 3.0), 'b': (0.5, 3.0)}
POLES = 'these are the closed-loop poles; wanted the gain K of u = -K x'
NEGATIVE = 'the sign: the law is u = -K x, so that K has no minus'
POSITIVE = 'the other root of the Riccati equation, for which P is not positive definite'
SCALAR_FILTER = {'a': (-2.0, 2.0), 'q': (0.2, 5.0), 'r': (0.2, 5.0)}
OMEGA = {'w': (0.2, 3.0)}
DOYLE = {'q': (0.2, 200.0)}
OMEGA0 = sqrt(50.0)   # [rad/s], of Exercise 2.10 with the gain (1, 2); zeta is 1/sqrt(2)


def find_end(a: float = 1.0, c: float = 1.0) -> float:
    """Return x(1) of the optimum of Exercise 2.4 with b = T = x(0) = 1."""
    return math.exp(-a) / (1.0 + c * (1.0 - math.exp(-2.0 * a)) / (2.0 * a))


def find_cost(a: float = 1.0, c: float = 1.0) -> float:
    """Return the minimum cost, 1/2 x(0) lambda(0)."""
    return 0.5 * c * find_end(a, c) * math.exp(-a)


def find_rise_time() -> float:
    """Return the time from 10 to 90 % of a step, for omega0 = 1 and zeta = 1/sqrt(2)."""
    def find_time(level: float) -> float:
        # y = 1 - e^(-w t) (cos(w t) + sin(w t)) rises until w t = pi.
        lower, upper = 0.0, math.pi
        while upper - lower > 1e-14:
            middle = (lower + upper) / 2.0
            reached = 1.0 - math.exp(-middle) * (math.cos(middle) + math.sin(middle)) >= level
            lower, upper = (lower, middle) if reached else (middle, upper)
        return sqrt(2.0) * lower

    return find_time(0.9) - find_time(0.1)


def find_extremal(t: Array) -> tuple[Array, Array, Array]:
    """Return x, u and lambda of Exercise 2.4 with a = b = c = T = x(0) = 1."""
    lam = find_end() * np.exp(t - 1.0)
    # x' = -x - lambda with lambda' = lambda
    return (np.exp(-t) - lam[0] * np.sinh(t))[:, None], -lam[:, None], lam[:, None]


def _with(names: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    return {**names, **EARLY}


EXERCISES: tuple[SheetQuestion, ...] = (
    FormulaQuestion(
        'exercise-2.1-a', 'Exercise 2.1 (a): F = (3, -2, 8) vanishes where G1 = (1, 0, 2) and '
        'G2 = (0, 1, -1) do. Give the numbers l1, l2 with F = l1 G1 + l2 G2.', 'two numbers',
        ((3.0, -2.0),), {},
        ((((-2.0, 3.0),), 'l1 and l2 are exchanged'),),
        'the first two entries of F are l1 and l2'),
    FormulaQuestion(
        'exercise-2.1-b',
        'Exercise 2.1 (b): for f = (x1 - a)^2 + (x2 - b)^2 and g = x1 - x2, give the '
        'multiplier l with which f + l g has an extremal point at the minimum.',
        'formula of a, b', 'a - b', {'a': (-2.0, 2.0), 'b': (-2.0, 2.0)},
        (('b - a', 'the sign: this is the multiplier of f - l g'),
         ('(a - b)/2', 'the derivative of (x1 - a)^2 is 2 (x1 - a)')),
        'df/dx1 + l dg/dx1 = 0 at x1 = (a + b)/2'),
    FormulaQuestion(
        'exercise-2.2-cost', "Exercise 2.2 (b): q' = u, Y' = q u' - u q'. Give the minimum of "
        "1/2 int u'u dt over [0, 1] for y = (1, 2, 2).", 'number', 3.0 * math.pi, {},
        ((9.0 * math.pi, 'the cost grows with |y|, not with |y|^2'),
         (6.0 * math.pi, 'either the factor 1/2 of the cost is missing, or Y was taken for the '
          'area of the loop; it is twice that')),
        'the loop is a circle: length^2 = 4 pi area, |y| = 2 area, cost = length^2/2'),
    FormulaQuestion(
        'exercise-2.2-speed', 'Exercise 2.2 (b): give |u| for y = (1, 2, 2).', 'number',
        sqrt(6.0 * math.pi), {},
        ((6.0 * math.pi, 'this is |u|^2'),
         (sqrt(12.0 * math.pi), 'Y is twice the area of the loop')),
        '|u| is the length of the circle, which is run through in 1 s'),
    FormulaQuestion(
        'exercise-2.3-costate',
        "Exercise 2.3: minimise int x'^T x' dt over [0, 1] from (0, 0) to (3, 4), "
        "with H = u^T u + lambda u. Give lambda = (lambda1, lambda2).", 'two numbers',
        ((-6.0, -8.0),), {},
        ((((6.0, 8.0),), SIGN),
         (((-3.0, -4.0),), 'dH/du = 2 u + lambda: the factor 2 is missing')),
        'dH/du = 0 for u = (3, 4)'),
    FormulaQuestion(
        'exercise-2.4-a-costate',
        "Exercise 2.4 (a): x' = -a x + b u, J = 1/2 int u^2 + 1/2 c x(T)^2, "
        't0 = 0. Give the costate lambda(t).', 'formula of a, b, c, x0, t, T',
        f'c*exp(a*(t - T))*{END}', _with(SCALAR),
        ((f'-c*exp(a*(t - T))*{END}', SIGN), (f'c*exp(-a*(t - T))*{END}', BACKWARDS)),
        "lambda' = -dH/dx = a lambda, and lambda(T) = c x(T)"),
    FormulaQuestion(
        'exercise-2.4-a-input', 'Exercise 2.4 (a): give the optimal input u(t).',
        'formula of a, b, c, x0, t, T', f'-b*c*exp(a*(t - T))*{END}', _with(SCALAR),
        ((f'b*c*exp(a*(t - T))*{END}', 'this input maximises H: u = -b lambda follows from '
          'dH/du = u + b lambda = 0'),
         (f'-c*exp(a*(t - T))*{END}', 'the factor b is missing: dH/du = u + b lambda'),
         (f'-b*c*exp(-a*(t - T))*{END}', BACKWARDS),
         ('-b*c*exp(-a*(t - T))*exp(a*T)*x0/(1 + b**2*c*(exp(2*a*T) - 1)/(2*a))',
          "this solves Example 2.2, x' = a x + b u; here x' = -a x + b u")),
        'u = -b lambda; lambda is the costate of the question before'),
    FormulaQuestion(
        'exercise-2.4-a-end', 'Exercise 2.4 (a): give the terminal state x(T).',
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
        'exercise-2.4-a-limit',
        'Exercise 2.4 (a): give the limit of x(T) for c to infinity.', 'number',
        0.0, {}, (), 'the larger c is, the more a terminal state other than 0 costs'),
    ExtremalQuestion(
        'exercise-2.4-a-extremal',
        'Exercise 2.4 (a) with a = b = c = T = x0 = 1: give x(t), u(t) and '
        'lambda(t).', 'keys x, u, lam with formulas of t', STATEMENT),
    ProblemQuestion(
        'exercise-2.4-a-problem',
        'Exercise 2.4 (a) with a = b = c = T = x0 = 1: state the problem as a '
        'problem file, with the state x and the input u.', 'keys of a problem file',
        find_cost(), find_extremal, 1.0,
        ((2.0 * find_cost(), 'both factors 1/2 of the cost are missing'),
         (find_cost(c=2.0), 'the factor 1/2 of the terminal cost is missing'),
         (2.0 * find_cost(c=0.5), 'the factor 1/2 of the running cost is missing'),
         (find_cost(a=-1.0), "the sign of the dynamics: x' = -a x + b u"))),
    FormulaQuestion(
        'exercise-2.4-c-input',
        'Exercise 2.4 (c): give the input of the flat trajectory from x0 to xf, '
        'with as few basis functions as possible.', 'formula of a, b, x0, xf, t, T',
        f'((xf - x0)/T + a*{LINE})/b', _with(FLAT),
        ((f'(xf - x0)/T + a*{LINE}', 'the division by b is missing'),
         ('(xf - x0)/(T*b)', "the term a x is missing: u = (x' + a x)/b"),
         (f'((xf - x0)/T - a*{LINE})/b', "the sign of a x: b u = x' + a x")),
        "x is a flat output: u = (x' + a x)/b with a straight line x(t)"),
    FormulaQuestion(
        'exercise-2.4-d-cost', 'Exercise 2.4 (d), with a = b = 1, from x(0) = 0 to x(1) = 1: give '
        '1/2 int u^2 of the flat trajectory.', 'number', 7.0 / 6.0, {},
        ((0.5, 'this is the cost of u = 1; the input of the flat trajectory is 1 + t'),),
        'u = 1 + t'),
    FormulaQuestion(
        'exercise-2.4-d-optimum',
        'Exercise 2.4 (d), with a = b = 1, from x(0) = 0 to x(1) = 1: give the '
        'least 1/2 int u^2.', 'number', 1.0 / (1.0 - math.exp(-2.0)), {},
        ((7.0 / 6.0, 'this is the cost of the flat trajectory'),),
        'u = k e^t with the k for which x(1) = 1'),
    FormulaQuestion(
        'exercise-2.5-costate',
        "Exercise 2.5 (a): x' = -a x^3 + b u. Give lambda' of Pontryagin's "
        'conditions.', 'formula of a, x, lam', '3*a*x**2*lam',
        {'a': (0.5, 2.0), 'x': (-2.0, 2.0), 'lam': (-2.0, 2.0)},
        (('-3*a*x**2*lam', "the sign of the costate equation: lambda' = -dH/dx"),
         ('a*x**2*lam', 'the derivative of x^3 is 3 x^2'),
         ('a*x**3*lam', 'f has to be differentiated by x'),
         ('3*a*x**2', "lambda' is linear in lambda")),
        "lambda' = -dH/dx with H = u^2/2 + lambda (-a x^3 + b u)"),
    FormulaQuestion(
        'exercise-2.5-c-input',
        'Exercise 2.5 (c): give the input of the flat trajectory from x0 to xf, '
        'with as few basis functions as possible.', 'formula of a, b, x0, xf, t, T',
        f'((xf - x0)/T + a*{LINE}**3)/b', _with(FLAT),
        ((f'((xf - x0)/T + a*{LINE})/b',
          'this is the input for the linear system of Exercise 2.4'),
         (f'(xf - x0)/T + a*{LINE}**3', 'the division by b is missing')),
        "u = (x' + a x^3)/b with a straight line x(t)"),
    FormulaQuestion(
        'exercise-2.6-switching',
        'Exercise 2.6: give dH/dv, whose sign decides between forward and '
        'reverse.', 'formula of lam1, lam2, theta', 'lam1*cos(theta) + lam2*sin(theta)',
        {'lam1': (-2.0, 2.0), 'lam2': (-2.0, 2.0), 'theta': (-3.0, 3.0)},
        (('lam1*sin(theta) + lam2*cos(theta)', 'sine and cosine are exchanged'),
         ('-lam1*sin(theta) + lam2*cos(theta)', 'this is dH/dtheta over v, not dH/dv'),
         ('lam1*cos(theta*pi/180) + lam2*sin(theta*pi/180)',
          'theta is in radians; you convert from degrees')),
        'H = 1 + lambda1 v cos(theta) + lambda2 v sin(theta) + lambda3 omega'),
    FormulaQuestion(
        'exercise-2.6-turn',
        'Exercise 2.6: give the minimum time [s] to turn by 90 degrees in place, with '
        'M = 2 rad/s.', 'number', math.pi / 4.0, {},
        ((45.0, 'the angle is in degrees, M in rad/s: wanted radians'),
         (math.pi / 2.0, 'this is the time for M = 1 rad/s')),
        'the angle [rad] over the largest rate'),
    FormulaQuestion(
        'exercise-2.7-gain',
        "Exercise 2.7 for x1' = x2, x2' = u, y = x1, rho = 1/16: give the gain K.",
        '[k1, k2]', ((4.0, sqrt(8.0)),), {},
        ((((0.25, sqrt(0.125) / 2.0),),
          'the factor 1/rho is missing: K = R^-1 B^T P with R = rho'),
         (((16.0, sqrt(32.0)),), 'the weight rho occurs once: J = int y^T y + rho u^T u'),
         (((-4.0, -sqrt(8.0)),), NEGATIVE),
         (((-sqrt(2.0), sqrt(2.0)), (-sqrt(2.0), -sqrt(2.0))), POLES)),
        'P A + A^T P - P B R^-1 B^T P + H^T H = 0 with H = (1, 0), R = rho'),
    FormulaQuestion(
        'exercise-2.7-poles', 'Exercise 2.7, same system: give the closed-loop poles.',
        '[[real, imaginary], [real, imaginary]], the positive imaginary part first',
        ((-sqrt(2.0), sqrt(2.0)), (-sqrt(2.0), -sqrt(2.0))), {},
        ((((sqrt(2.0), sqrt(2.0)), (sqrt(2.0), -sqrt(2.0))),
          'these are the mirror images of the poles: the closed loop would be unstable'),
         (((4.0, sqrt(8.0)),), 'this is the gain; wanted the eigenvalues of A - B K'),
         (((-sqrt(2.0), -sqrt(2.0)), (-sqrt(2.0), sqrt(2.0))),
          'the pole with the positive imaginary part comes first')),
        's^2 + k2 s + k1 = 0'),
    FormulaQuestion(
        'exercise-2.8-a-riccati',
        'Exercise 2.8 (a): give the left side of the equation of the entry '
        '(2, 2) of the Riccati equation P A + A^T P - P B B^T P + Q = 0, which is 0.',
        'formula of a, p12, p22', '2*p12 - 2*a*p22 - p22**2',
        {'a': (0.5, 3.0), 'p12': (-2.0, 2.0), 'p22': (-2.0, 2.0)},
        (('2*p12 - 2*a*p22 - p22**2 + 1', 'the cost is x1^2 + u^2: Q = diag(1, 0)'),
         ('2*p12 + 2*a*p22 - p22**2', 'the entry (2, 2) of A is -a'),
         ('p12 - a*p22 - p22**2', 'P A and A^T P both contribute: the factor 2 is missing')),
        'multiply the matrices out'),
    FormulaQuestion(
        'exercise-2.8-b-gain', 'Exercise 2.8 (b): give the gain K.', '[k1, k2], formulas of a, b',
        ((1.0, 'sqrt(a**2 + 2) - a'),), PLANT,
        (((1.0, '-sqrt(a**2 + 2) - a'), POSITIVE),
         ((1.0, 'sqrt(a**2 + 2) + a'), 'the sign of a: the entry (2, 2) of A is -a'),
         ((1.0, 'sqrt(a**2 + 1) - a'), 'the factor 2 is missing: p22^2 + 2 a p22 = 2 p12'),
         (('b', 'sqrt(a**2 + 2*b + 1) - a'), 'this is the gain for y^2 + u^2; the cost is '
          'x1^2 + u^2'),
         ((-1.0, 'a - sqrt(a**2 + 2)'), NEGATIVE),
         (('sqrt(a**2 + 2)', 1.0), 'this is the first row of P; K = B^T P is the second')),
        'p12^2 = 1 and p22^2 + 2 a p22 = 2 p12, with P > 0'),
    FormulaQuestion(
        'exercise-2.8-c-frequency',
        'Exercise 2.8 (c): give the natural frequency of the closed loop.',
        'formula of a, b', 1.0, PLANT,
        (('a', 'this is the pole of the plant'),),
        's^2 + (a + k2) s + k1 = s^2 + 2 zeta omega0 s + omega0^2'),
    FormulaQuestion(
        'exercise-2.8-c-damping', 'Exercise 2.8 (c): give the damping ratio of the closed loop.',
        'formula of a, b', 'sqrt(a**2 + 2)/2', PLANT,
        (('(sqrt(a**2 + 2) - a)/2', 'the plant has damping of its own: the coefficient of s is '
          'a + k2'),),
        's^2 + (a + k2) s + k1 = s^2 + 2 zeta omega0 s + omega0^2'),
    FormulaQuestion(
        'exercise-2.9-a-riccati',
        "Exercise 2.9 (a): x' = a x + b u, J = 1/2 int u^2 with x(t) to 0. Give "
        'the positive P.', 'formula of a, b', '2*a/b**2', PLANT,
        ((0.0, 'with P = 0 the state grows: this root does not lead to x(t) = 0'),
         ('2*a/b', 'this is the gain b P; wanted P')),
        '2 a P - b^2 P^2 = 0'),
    FormulaQuestion(
        'exercise-2.9-a-gain', 'Exercise 2.9 (a): give the k of the feedback u = -k x.',
        'formula of a, b', '2*a/b', PLANT,
        (('2*a/b**2', 'this is P; the factor b is missing: u = -b P x'),
         ('a/b', 'this cancels a x, so that x stays where it is; the optimum moves the pole from '
          'a to -a'),
         ('-2*a/b', NEGATIVE), ('-a', 'this is the closed-loop pole; wanted the gain')),
        'u = -b P x'),
    FormulaQuestion(
        'exercise-2.9-b-end',
        'Exercise 2.9 (b): a = 2, b = 0.5, x(0) = 4. Give x(tf) of the optimum for '
        'c = 10, tf = 1.', 'number',
        'exp(2)*4/(1 + 0.25*10*(exp(4) - 1)/4)', {},
        (('exp(-2)*4', 'this is the infinite horizon'),
         ('exp(2)*4', 'this is the state without an input'),
         ('exp(2)*4/(1 + 0.5*10*(exp(4) - 1)/4)',
          'b occurs twice: in the dynamics and in u = -b lambda')),
        "solve x' = a x - b^2 lambda with lambda(t) = c x(tf) e^(a (tf - t)), then set t = tf"),
    FormulaQuestion(
        'exercise-2.10-A',
        'Exercise 2.10 (a), vd = 10 m/s, l = 2 m: give A of the linearization about '
        'y = 0, theta = 0, phi = 0, for the state (y, theta).', '2 rows of 2 numbers',
        ((0.0, 10.0), (0.0, 0.0)), {},
        ((((0.0, 1.0), (0.0, 0.0)), "y' = vd sin(theta): the factor vd is missing"),
         (((0.0, 10.0), (0.0, 5.0)), 'phi is the input, not a state')),
        'differentiate f by y and theta'),
    FormulaQuestion(
        'exercise-2.10-B',
        'Exercise 2.10 (a): give B.', '2 rows of 1 number', ((0.0,), (5.0,)), {},
        ((((0.0,), (10.0,)), "theta' = (vd/l) tan(phi): the division by l = 2 m is missing"),
         (((0.0,), (0.5,)), "theta' = (vd/l) tan(phi): the factor vd is missing"),
         (((5.0,), (0.0,)), 'the rows are exchanged: phi acts on theta')),
        'differentiate f by phi'),
    FormulaQuestion(
        'exercise-2.10-gain', 'Exercise 2.10 (a) with Qx = diag(1, 0), Qu = 1: give the gain K.',
        '[k1, k2]', ((1.0, 2.0),), {},
        ((((-5.0, 5.0), (-5.0, -5.0)), POLES),
         (((0.2, 0.2),), 'this is the first row of P: K = Qu^-1 B^T P, its second row times 5'),
         (((0.2, 0.4),), 'this is the second row of P: the factor B^T = (0, 5) is missing'),
         (((-1.0, -2.0),), NEGATIVE),
         (((180.0 / 3.141592653589793, 2.0),), 'phi is in degrees; wanted radians')),
        'p12 = 1/5 and 25 p22^2 = 20 p12; K = (5 p12, 5 p22)'),
    FormulaQuestion(
        'exercise-2.10-overshoot', 'Exercise 2.10 (a), with this gain: yd steps by 1 m. Give the '
        'overshoot of y for the linear model, as a fraction of the step.', 'number',
        math.exp(-math.pi), {},
        ((100.0 * math.exp(-math.pi), 'this is in percent'),
         (1.0 + math.exp(-math.pi), 'this is the peak; the overshoot is what exceeds 1 m'),
         (math.exp(-math.pi / sqrt(2.0)), 'this is e^(-pi zeta): the exponent is divided by '
          'sqrt(1 - zeta^2)'),
         (math.exp(-2.0 * math.pi), 'this is the minimum after the peak')),
        "y' vanishes after half a period of the damped oscillation; zeta = 1/sqrt(2)"),
    FormulaQuestion(
        'exercise-2.10-rise', 'Exercise 2.10 (a): give the time [s] in which y rises from 10 to '
        '90 % of the step.', 'number', find_rise_time() / OMEGA0, {},
        ((find_rise_time(), 'this is the time for omega0 = 1 rad/s'),
         (math.pi / (OMEGA0 / sqrt(2.0)), 'this is the time of the peak'),
         (0.75 * math.pi / (OMEGA0 / sqrt(2.0)), 'this is the time to 100 %')),
        'y = 1 - e^(-w t) (cos(w t) + sin(w t)) with w = omega0/sqrt(2)'),
    FormulaQuestion(
        'exercise-2.10-bandwidth', 'Exercise 2.10 (a): give the frequency [rad/s] at which the '
        'transfer function from yd to y has the magnitude 1/sqrt(2).', 'number', OMEGA0, {},
        ((OMEGA0 / (2.0 * math.pi), 'this is in Hz'),
         (OMEGA0**2, 'this is the square of the frequency'),
         (OMEGA0 * sqrt(1.0 + sqrt(2.0)), 'this is where the loop transfer function has the '
          'magnitude 1')),
        'the characteristic polynomial is s^2 + 10 s + 50'),
    FormulaQuestion(
        'exercise-2.10-crossover', 'Exercise 2.10 (a): the loop is broken at the steering. Give '
        'the frequency [rad/s] at which its transfer function has the magnitude 1.', 'number',
        OMEGA0 * sqrt(1.0 + sqrt(2.0)), {},
        ((OMEGA0, 'this is the natural frequency of the closed loop'),
         (OMEGA0 * sqrt(1.0 + sqrt(2.0)) / (2.0 * math.pi), 'this is in Hz'),
         (10.0, 'here the derivative part alone has the magnitude 1')),
        'L = K (s I - A)^-1 B = (10 s + 50)/s^2'),
    FormulaQuestion(
        'exercise-2.10-margin', 'Exercise 2.10 (a): give the phase margin [rad].', 'number',
        math.atan(sqrt(2.0 + 2.0 * sqrt(2.0))), {},
        ((math.atan(sqrt(2.0 + 2.0 * sqrt(2.0))) - math.pi, 'this is the phase of the loop; the '
          'margin is its distance from -pi'),
         (math.pi / 2.0 - math.atan(sqrt(2.0 + 2.0 * sqrt(2.0))), 'this is the angle to '
          '-pi/2; the double integrator has the phase -pi'),
         (math.pi / 3.0, 'this is the least phase margin of a regulator; this one has more')),
        'at the crossover frequency w, L = (50 + 10 j w)/(-w^2)'),
    FormulaQuestion(
        'exercise-2.10-b-heading', "Exercise 2.10 (b): y = r(t). Give theta_d from dr = r'.",
        'formula of dr', 'asin(dr/10)', {'dr': (-6.0, 6.0)},
        (('dr/10', 'this is the feedforward of the linear model; follow the nonlinear one'),
         ('acos(dr/10)', 'theta is measured from the x axis'),
         ('atan(dr/10)', "vd is the speed along the path: y' = vd sin(theta)")),
        "y' = vd sin(theta)"),
    FormulaQuestion(
        'exercise-2.10-b-steering', "Exercise 2.10 (b): give phi_d from dr = r' and ddr = r''.",
        'formula of dr, ddr', 'atan(2*ddr/(10*sqrt(100 - dr**2)))',
        {'dr': (-6.0, 6.0), 'ddr': (-40.0, 40.0)},
        (('ddr/50', 'this is the feedforward of the linear model; follow the nonlinear one'),
         ('2*ddr/(10*sqrt(100 - dr**2))', "theta' = (vd/l) tan(phi): the arc tangent is missing"),
         ('atan(ddr/50)', "theta' = r''/(vd cos(theta)): the cosine is missing"),
         ('atan(2*ddr/sqrt(100 - dr**2))', "theta' = (vd/l) tan(phi): the division by vd is "
          'missing'),
         ('atan(ddr/(10*sqrt(100 - dr**2)))', "theta' = (vd/l) tan(phi): the factor l is "
          'missing')),
        "differentiate sin(theta) = r'/vd, and put theta' into theta' = (vd/l) tan(phi)"),
    FormulaQuestion(
        'estimation-1-variance', "Estimation 1: x' = a x + w, y = x + v, intensities q of w and r "
        'of v. Give the variance p of the error of the steady Kalman filter.',
        'formula of a, q, r', 'r*(a + sqrt(a**2 + q/r))', SCALAR_FILTER,
        (('r*(a - sqrt(a**2 + q/r))', 'the other root of the Riccati equation: p is positive'),
         ('a + sqrt(a**2 + q/r)', 'this is the gain p/r'),
         ('r*(-a + sqrt(a**2 + q/r))', 'the sign of a: 2 a p - p^2/r + q = 0'),
         ('r*(a + sqrt(a**2 + q*r))', 'the root of a^2 + q/r: p^2 has the factor 1/r')),
        '2 a p - p^2/r + q = 0 with p > 0'),
    FormulaQuestion(
        'estimation-1-gain', "Estimation 1: give the gain L of xe' = a xe + L (y - xe).",
        'formula of a, q, r', 'a + sqrt(a**2 + q/r)', SCALAR_FILTER,
        (('r*(a + sqrt(a**2 + q/r))', 'this is p; the gain is p/r'),
         ('-sqrt(a**2 + q/r)', 'this is the pole a - L; wanted L'),
         ('sqrt(q/r)', 'this is the gain for a = 0')),
        'L = p C^T/r with C = 1'),
    FormulaQuestion(
        'estimation-1-pole', 'Estimation 1: give the pole of the filter.', 'formula of a, q, r',
        '-sqrt(a**2 + q/r)', SCALAR_FILTER,
        (('a + sqrt(a**2 + q/r)', 'this is the gain L; the pole is a - L'),
         ('2*a + sqrt(a**2 + q/r)', 'the pole is a - L, not a + L')),
        'the error of the estimate has the dynamics a - L'),
    FormulaQuestion(
        'estimation-2-gain', "Estimation 2: x1' = x2, x2' = d, y = x1 + v, intensities q of d and "
        'r of v, w = (q/r)^(1/4). Give the gain of the steady Kalman filter.',
        '[l1, l2], formulas of w', (('sqrt(2)*w', 'w**2'),), OMEGA,
        ((('w**2', 'sqrt(2)*w'), 'the rows are exchanged: the position is corrected by '
          'sqrt(2) w, the velocity by w^2. A regulator has the gain [w^2, sqrt(2) w]'),
         (('w**2', 'sqrt(2)*w**3'), 'this is the second column of P/r; L = P C^T/r is the first'),
         (('sqrt(2)*w**2', 'w**4'), 'this is the gain for w = (q/r)^(1/2)')),
        'A P + P A^T - P C^T C P/r + Q = 0 with Q = diag(0, q): p11^2 = 2 r p12, p12^2 = q r'),
    FormulaQuestion(
        'estimation-2-damping', 'Estimation 2: give the damping ratio of the poles of the filter.',
        'number', 1.0 / sqrt(2.0), {},
        ((sqrt(2.0), 'the coefficient of s is 2 zeta w'),),
        's^2 + l1 s + l2 = s^2 + 2 zeta w s + w^2'),
    FormulaQuestion(
        'estimation-3-gain', 'Estimation 3 (Doyle 1978): A = [[1, 1], [0, 1]], B = (0, 1), '
        'Qx = q [[1, 1], [1, 1]], Qu = 1. Give the f of the gain K = f [1, 1].', 'formula of q',
        '2 + sqrt(4 + q)', DOYLE,
        (('2 - sqrt(4 + q)', 'the other root of the Riccati equation: the loop would be unstable'),
         ('sqrt(4 + q)', 'half of the coefficient of f is missing: (f - 2)^2 is not f^2'),
         ('2 + sqrt(q)', 'complete the square: f^2 - 4 f and (f - 2)^2 differ by 4')),
        'f^2 - 4 f - q = 0'),
    FormulaQuestion(
        'estimation-3-margin', 'Estimation 3: with the filter L = d [1, 1]^T, the plant has the '
        'gain m in place of 1. For which m does the constant of the characteristic polynomial '
        'vanish?', 'formula of d, f', '1 + 1/(d*f)', {'d': (4.0, 20.0), 'f': (4.0, 20.0)},
        (('1/(d*f)', 'this is m - 1'),
         ('1 - 1/(d*f)', 'the constant is 1 + (1 - m) d f: it vanishes above m = 1'),
         ('1 - (d + f - 4)/(2*d*f)', 'here the coefficient of s vanishes, not the constant'),
         ('2/f', 'this is the smallest gain with the whole state')),
        'the constant of the characteristic polynomial is 1 + (1 - m) d f'),
    FormulaQuestion(
        'receding-horizon-1-limit', "Receding horizon 1: x' = a x + b u, |u| <= U, a > 0. Give "
        'the largest |x| from which an input can keep |x| from growing.', 'formula of a, b, U',
        'b*U/a', {'a': (0.5, 3.0), 'b': (0.5, 3.0), 'U': (0.5, 3.0)},
        (('U/a', 'the factor b of the input is missing'),
         ('a*U/b', 'a and b are exchanged'),
         ('U/b', 'a x + b u = 0 with u = U: the factor a is missing')),
        "at the limit x' = 0 with the largest input"),
    FormulaQuestion(
        'receding-horizon-1-input', 'Receding horizon 1: the regulator is u = -2 x, |u| <= 1, and '
        'its cost-to-go is the terminal cost. Give the first input of the optimal plan over 10 '
        'periods from x = 0.8.', 'number', -1.0, {},
        ((-1.6, 'this is the regulator without the bound'), (-0.8, 'this is -x; the gain is 2'),
         (0.0, 'a plan that waits costs more')),
        'with one state, the plan of any length begins with the saturated regulator'),
    FormulaQuestion(
        'receding-horizon-2-sets', 'Receding horizon 2: one input with a lower and an upper '
        'bound, N = 3 periods. How many sets of active bounds are there to enumerate?', 'number',
        27.0, {},
        ((8.0, 'each input is at its lower bound, inside, or at its upper bound: three cases'),
         (9.0, 'this is 3 N; the choices of the N inputs multiply'),
         (64.0, 'both bounds of one input are not active together')),
        'each of the N inputs has three cases'))
