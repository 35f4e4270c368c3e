# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Questions on Kalman filters: a scalar plant, and a double integrator."""

from math import sqrt

from obc_ros.cli.teaching.question import FormulaQuestion

SCALAR_FILTER = {'a': (-2.0, 2.0), 'q': (0.2, 5.0), 'r': (0.2, 5.0)}
OMEGA = {'w': (0.2, 3.0)}

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
        'estimation-2-gain', "Estimation 2: x1' = x2, x2' = w, y = x1 + v, intensities q of w and "
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
        's^2 + l1 s + l2 = s^2 + 2 zeta w s + w^2'))
