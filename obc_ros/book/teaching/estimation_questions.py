# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Questions on Kalman filters, their margins in the loop, and receding horizons."""

from math import sqrt

from obc_ros.book.teaching.question import FormulaQuestion

SCALAR_FILTER = {'a': (-2.0, 2.0), 'q': (0.2, 5.0), 'r': (0.2, 5.0)}
OMEGA = {'w': (0.2, 3.0)}
DOYLE = {'q': (0.2, 200.0)}

ESTIMATION_QUESTIONS = (
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
         ('sqrt(4 + q)', 'the roots of f^2 - 4 f - q = 0 are 2 +- sqrt(4 + q)'),
         ('2 + sqrt(q)', 'the roots of f^2 - 4 f - q = 0 are 2 +- sqrt(4 + q)')),
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
