# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Questions of sections 2.4 to 2.6: Example 2.4, Exercises 2.7 to 2.10."""

from math import sqrt

from obc_ros.book.teaching.question import FormulaQuestion

WEIGHT = {'q': (0.2, 5.0)}
PLANT = {'a': (0.5, 3.0), 'b': (0.5, 3.0)}
POLES = 'these are the closed-loop poles; wanted the gain K of u = -K x'
NEGATIVE = 'the sign: the law is u = -K x, so that K has no minus'
POSITIVE = 'the other root of the Riccati equation, for which P is not positive definite'

REGULATOR_QUESTIONS = (
    FormulaQuestion(
        'example-2.4-gain', "Example 2.4: x1' = x2, x2' = u, Qx = diag(q^2, 0), Qu = 1. Give the "
        'gain K of u = -K x.', '[k1, k2], formulas of q', (('q', 'sqrt(2*q)'),), WEIGHT,
        ((('1/q', 'sqrt(2/q)'), 'this is printed in the book, and a misprint: it belongs to '
          'Qx = diag(1, 0), Qu = q^2. From P follows K = Qu^-1 B^T P, its second row'),
         (('sqrt(2*q**3)', 'q'), 'this is the first row of P: K = Qu^-1 B^T P is the second'),
         (('-q', '-sqrt(2*q)'), NEGATIVE),
         (('sqrt(q)', 'sqrt(2*sqrt(q))'), 'this is the gain for Qx = diag(q, 0); here it is q^2'),
         (('q**2', 'sqrt(2)*q'), 'this is the gain for Qx = diag(q^4, 0); here it is q^2')),
        'put K = (P12, P22) into the Riccati equation: P12^2 = q^2, P22^2 = 2 P12'),
    FormulaQuestion(
        'example-2.4-frequency', 'Example 2.4: give the natural frequency of the closed loop.',
        'formula of q', 'sqrt(q)', WEIGHT,
        (('sqrt(1/q)', 'this is printed in the book, and a misprint'),
         ('q', 'this is the square of the frequency, the last coefficient of s^2 + k2 s + k1')),
        's^2 + k2 s + k1 = s^2 + 2 zeta omega0 s + omega0^2'),
    FormulaQuestion(
        'example-2.4-damping', 'Example 2.4: give the damping ratio of the closed loop.',
        'number', 1.0 / sqrt(2.0), {},
        ((sqrt(2.0), 'the coefficient of s is 2 zeta omega0'),),
        's^2 + k2 s + k1 = s^2 + 2 zeta omega0 s + omega0^2'),
    FormulaQuestion(
        '2.7-gain', "Exercise 2.7 for x1' = x2, x2' = u, y = x1, rho = 1/16: give the gain K.",
        '[k1, k2]', ((4.0, sqrt(8.0)),), {},
        ((((0.25, sqrt(0.125) / 2.0),),
          'the factor 1/rho is missing: K = R^-1 B^T P with R = rho'),
         (((16.0, sqrt(32.0)),), 'the weight rho occurs once: J = int y^T y + rho u^T u'),
         (((-4.0, -sqrt(8.0)),), NEGATIVE),
         (((-sqrt(2.0), sqrt(2.0)), (-sqrt(2.0), -sqrt(2.0))), POLES)),
        'P A + A^T P - P B R^-1 B^T P + H^T H = 0 with H = (1, 0), R = rho'),
    FormulaQuestion(
        '2.7-poles', 'Exercise 2.7, same system: give the closed-loop poles.',
        '[[real, imaginary], [real, imaginary]], the positive imaginary part first',
        ((-sqrt(2.0), sqrt(2.0)), (-sqrt(2.0), -sqrt(2.0))), {},
        ((((sqrt(2.0), sqrt(2.0)), (sqrt(2.0), -sqrt(2.0))),
          'these are the mirror images of the poles: the closed loop would be unstable'),
         (((4.0, sqrt(8.0)),), 'this is the gain; wanted the eigenvalues of A - B K'),
         (((-sqrt(2.0), -sqrt(2.0)), (-sqrt(2.0), sqrt(2.0))),
          'the pole with the positive imaginary part comes first')),
        's^2 + k2 s + k1 = 0'),
    FormulaQuestion(
        '2.8-a-riccati', 'Exercise 2.8 (a): give the left side of the equation of the entry '
        '(2, 2) of the Riccati equation P A + A^T P - P B B^T P + Q = 0, which is 0.',
        'formula of a, p12, p22', '2*p12 - 2*a*p22 - p22**2',
        {'a': (0.5, 3.0), 'p12': (-2.0, 2.0), 'p22': (-2.0, 2.0)},
        (('2*p12 - 2*a*p22 - p22**2 + 1', 'the cost is x1^2 + u^2: Q = diag(1, 0)'),
         ('2*p12 + 2*a*p22 - p22**2', 'the entry (2, 2) of A is -a'),
         ('p12 - a*p22 - p22**2', 'P A and A^T P both contribute: the factor 2 is missing')),
        'multiply the matrices out'),
    FormulaQuestion(
        '2.8-b-gain', 'Exercise 2.8 (b): give the gain K.', '[k1, k2], formulas of a, b',
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
        '2.8-c-frequency', 'Exercise 2.8 (c): give the natural frequency of the closed loop.',
        'formula of a, b', 1.0, PLANT,
        (('a', 'this is the pole of the plant'),),
        's^2 + (a + k2) s + k1 = s^2 + 2 zeta omega0 s + omega0^2'),
    FormulaQuestion(
        '2.8-c-damping', 'Exercise 2.8 (c): give the damping ratio of the closed loop.',
        'formula of a, b', 'sqrt(a**2 + 2)/2', PLANT,
        (('(sqrt(a**2 + 2) - a)/2', 'the plant has damping of its own: the coefficient of s is '
          'a + k2'),),
        's^2 + (a + k2) s + k1 = s^2 + 2 zeta omega0 s + omega0^2'),
    FormulaQuestion(
        '2.9-a-riccati', "Exercise 2.9 (a): x' = a x + b u, J = 1/2 int u^2 with x(t) to 0. Give "
        'the positive P.', 'formula of a, b', '2*a/b**2', PLANT,
        ((0.0, 'with P = 0 the state grows: this root does not lead to x(t) = 0'),
         ('2*a/b', 'this is the gain b P; wanted P')),
        '2 a P - b^2 P^2 = 0'),
    FormulaQuestion(
        '2.9-a-gain', 'Exercise 2.9 (a): give the k of the feedback u = -k x.',
        'formula of a, b', '2*a/b', PLANT,
        (('2*a/b**2', 'this is P; the factor b is missing: u = -b P x'),
         ('a/b', 'this cancels a x, so that x stays where it is; the optimum moves the pole from '
          'a to -a'),
         ('-2*a/b', NEGATIVE), ('-a', 'this is the closed-loop pole; wanted the gain')),
        'u = -b P x'),
    FormulaQuestion(
        '2.9-b-end', 'Exercise 2.9 (b): a = 2, b = 0.5, x(0) = 4. Give x(tf) of the optimum for '
        'c = 10, tf = 1.', 'number',
        'exp(2)*4/(1 + 0.25*10*(exp(4) - 1)/4)', {},
        (('exp(-2)*4', 'this is the infinite horizon'),
         ('exp(2)*4', 'this is the state without an input'),
         ('exp(2)*4/(1 + 0.5*10*(exp(4) - 1)/4)',
          'b occurs twice: in the dynamics and in u = -b lambda')),
        'x(tf) = e^(a tf) x(0)/(1 + b^2 c (e^(2 a tf) - 1)/(2 a))'),
    FormulaQuestion(
        '2.10-A', 'Exercise 2.10 (a), vd = 10 m/s, l = 2 m: give A of the linearization about '
        'y = 0, theta = 0, phi = 0, for the state (y, theta).', '2 rows of 2 numbers',
        ((0.0, 10.0), (0.0, 0.0)), {},
        ((((0.0, 1.0), (0.0, 0.0)), "y' = vd sin(theta): the factor vd is missing"),
         (((0.0, 10.0), (0.0, 5.0)), 'phi is the input, not a state')),
        'differentiate f by y and theta'),
    FormulaQuestion(
        '2.10-B', 'Exercise 2.10 (a): give B.', '2 rows of 1 number', ((0.0,), (5.0,)), {},
        ((((0.0,), (10.0,)), "theta' = (vd/l) tan(phi): the division by l = 2 m is missing"),
         (((0.0,), (0.5,)), "theta' = (vd/l) tan(phi): the factor vd is missing"),
         (((5.0,), (0.0,)), 'the rows are exchanged: phi acts on theta')),
        'differentiate f by phi'),
    FormulaQuestion(
        '2.10-gain', 'Exercise 2.10 (a) with Qx = diag(1, 0), Qu = 1: give the gain K.',
        '[k1, k2]', ((1.0, 2.0),), {},
        ((((-5.0, 5.0), (-5.0, -5.0)), POLES),
         (((0.2, 0.2),), 'this is the first row of P: K = Qu^-1 B^T P, its second row times 5'),
         (((0.2, 0.4),), 'this is the second row of P: the factor B^T = (0, 5) is missing'),
         (((-1.0, -2.0),), NEGATIVE),
         (((180.0 / 3.141592653589793, 2.0),), 'phi is in degrees; wanted radians')),
        'p12 = 1/5 and 25 p22^2 = 20 p12; K = (5 p12, 5 p22)'))
