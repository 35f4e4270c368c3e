# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Questions on the examples of the chapter."""

import math
from math import sqrt

from obc_ros.book.teaching.exercises import EARLY, NEGATIVE, POSITION_WEIGHT, SCALAR, SIGN
from obc_ros.book.teaching.question import FormulaQuestion, SheetQuestion

# Example 2.2: x(T) of the optimum, and that of Exercise 2.4.
END = 'exp(a*T)*x0/(1 + b**2*c*(exp(2*a*T) - 1)/(2*a))'
MIRRORED = 'exp(-a*T)*x0/(1 + b**2*c*(1 - exp(-2*a*T))/(2*a))'
OTHER_SIGN = "this solves Exercise 2.4, x' = -a x + b u; here x' = a x + b u"

# The gain of x' = a x + b u with the weights q and r.
LINEAR = '(a + sqrt(a**2 + b**2*q/r))/b'
LINEAR_NAMES = dict.fromkeys(('a', 'b', 'q', 'r'), (0.5, 2.0))

EXAMPLES: tuple[SheetQuestion, ...] = (
    FormulaQuestion(
        'example-2.1-minimum', 'Example 2.1: minimise (x1 - a)^2 + (x2 - b)^2 with x1 - x2 = 0. '
        'Give x1 at the minimum.', 'formula of a, b', '(a + b)/2',
        {'a': (-2.0, 2.0), 'b': (-2.0, 2.0)},
        (('a', 'this is the minimum without the constraint'),
         ('(a - b)/2', 'the constraint is x1 = x2, not x1 = -x2')),
        'both gradients vanish in sum: dF/dx + lambda dG/dx = 0, and x1 = x2'),
    FormulaQuestion(
        'example-2.1-inequality', 'Example 2.1 with x1 - x2 <= p in place of x1 = x2, where '
        'a - b > p: give the multiplier mu of the constraint.', 'formula of a, b, p', 'a - b - p',
        {'a': (2.0, 3.0), 'b': (-1.0, 0.0), 'p': (0.0, 1.0)},
        ((0.0, '(a, b) is not allowed, as a - b > p: the constraint is active'),
         ('a - b', 'at the minimum x1 = x2 + p'),
         ('b - a + p', 'the sign: mu >= 0 belongs to x1 - x2 - p <= 0 in F + mu (x1 - x2 - p)'),
         ('(a - b - p)/2', 'the derivative of (x1 - a)^2 is 2 (x1 - a)'),
         ('2*(a - b - p)', 'x2 does not stay at b: x1 and x2 move by half of the way each')),
        'dF/dx + mu d(x1 - x2)/dx = 0, and x1 - x2 = p'),
    FormulaQuestion(
        'section-2.2-tracking', "Section 2.2: x' = a x + b u shall follow (xd, ud), where "
        "xd' = a xd + b ud, with the least int q (x - xd)^2 + r (u - ud)^2 over [0, inf). Give u.",
        'formula of a, b, q, r, x, xd, ud', f'ud - {LINEAR}*(x - xd)',
        LINEAR_NAMES | dict.fromkeys(('x', 'xd', 'ud'), (-2.0, 2.0)),
        ((f'-{LINEAR}*(x - xd)', 'the input ud, which keeps x on xd, is missing'),
         (f'-{LINEAR}*x', 'this is the regulator to 0; the state of the regulator is x - xd'),
         (f'ud - {LINEAR}*x', 'the state of the regulator is the deviation from xd'),
         (f'ud + {LINEAR}*(x - xd)', 'the sign of the feedback'),
         (f'ud - b/r*{LINEAR}*(x - xd)', 'the gain has the factor b/r twice')),
        "e = x - xd and v = u - ud are a regulator problem: e' = a e + b v"),
    FormulaQuestion(
        'section-2.2-input', 'Section 2.2, same system: which constant ud makes a constant xd a '
        'trajectory?', 'formula of a, b, xd', '-a*xd/b',
        {'a': (0.5, 2.0), 'b': (0.5, 2.0), 'xd': (0.5, 2.0)},
        (('a*xd/b', 'the sign: the input balances a xd'),
         (0.0, 'without an input x leaves xd, unless xd = 0'),
         ('-a*xd', 'the input acts by b')),
        "xd' = 0"),
    FormulaQuestion(
        'theorem-2.2-cost', "Exercise after Theorem 2.2: assume u = -k x with b k > a for "
        "x' = a x + b u. Give int q x^2 + r u^2 over [0, inf) from x(0) = x0.",
        'formula of a, b, k, q, r, x0', '(q + r*k**2)*x0**2/(2*(b*k - a))',
        {'a': (0.2, 0.8), 'b': (1.0, 2.0), 'k': (1.0, 3.0), 'q': (0.5, 2.0), 'r': (0.5, 2.0),
         'x0': (0.5, 2.0)},
        (('(q + r*k**2)*x0**2/(b*k - a)', 'x^2 decays twice as fast as x'),
         ('q*x0**2/(2*(b*k - a))', 'the input costs, too: u^2 = k^2 x^2'),
         ('(q + r*k)*x0**2/(2*(b*k - a))', 'u^2 = k^2 x^2'),
         ('(q + r*k**2)*x0**2/(2*(a - b*k))', "the sign: x' = (a - b k) x decays"),
         ('(q + r*k**2)*x0/(2*(b*k - a))', 'the cost is quadratic in x0')),
        "x' = (a - b k) x, and p x0^2 with 2 (a - b k) p + q + r k^2 = 0"),
    FormulaQuestion(
        'theorem-2.2-gain', 'Exercise after Theorem 2.2: give the k for which this cost is least.',
        'formula of a, b, q, r', LINEAR, LINEAR_NAMES,
        (('(a - sqrt(a**2 + b**2*q/r))/b', 'with the other root the loop is unstable: b k < a'),
         ('r*(a + sqrt(a**2 + b**2*q/r))/b**2', 'this is P; k = b P/r'),
         ('sqrt(q/r)', 'this is the gain for a = 0'),
         ('-(a + sqrt(a**2 + b**2*q/r))/b', NEGATIVE)),
        'the derivative of (q + r k^2)/(b k - a) by k vanishes'),
    FormulaQuestion(
        'example-2.2-costate', "Example 2.2: x' = a x + b u, J = 1/2 int u^2 + 1/2 c x(T)^2, "
        't0 = 0. Give the costate lambda(t).', 'formula of a, b, c, x0, t, T',
        f'c*exp(a*(T - t))*{END}', SCALAR | EARLY,
        ((f'-c*exp(a*(T - t))*{END}', SIGN),
         (f'c*exp(a*(t - T))*{END}', "the sign of the exponent: lambda' = -dH/dx = -a lambda, so "
          'that the costate decays'),
         (f'c*{END}', 'this is lambda(T); the costate is not constant'),
         (f'c*exp(a*(t - T))*{MIRRORED}', OTHER_SIGN)),
        "lambda' = -dH/dx = -a lambda, and lambda(T) = c x(T)"),
    FormulaQuestion(
        'example-2.2-input', 'Example 2.2: give the optimal input u(t).',
        'formula of a, b, c, x0, t, T', f'-b*c*exp(a*(T - t))*{END}', SCALAR | EARLY,
        ((f'b*c*exp(a*(T - t))*{END}', 'this input maximises H: u = -b lambda follows from '
          'dH/du = u + b lambda = 0'),
         (f'-c*exp(a*(T - t))*{END}', 'the factor b is missing: dH/du = u + b lambda'),
         (f'-b*c*exp(a*(t - T))*{MIRRORED}', OTHER_SIGN)),
        'u = -b lambda; lambda is the costate of the question before'),
    FormulaQuestion(
        'example-2.2-end', 'Example 2.2: give the terminal state x(T).',
        'formula of a, b, c, x0, T', END, SCALAR,
        (('exp(a*T)*x0', 'this is the state without an input'),
         ('exp(a*T)*x0/(1 + b**2*c*(exp(2*a*T) - 1)/a)',
          'the integral of e^(2 a s) over [0, T] has the factor 1/(2 a)'),
         ('exp(a*T)*x0/(1 + b*c*(exp(2*a*T) - 1)/(2*a))',
          'b occurs twice: in the dynamics and in u = -b lambda'),
         ('exp(a*T)*x0/(1 - b**2*c*(exp(2*a*T) - 1)/(2*a))',
          "the sign of the feedback: x' = a x - b^2 lambda"),
         (MIRRORED, OTHER_SIGN)),
        "solve x' = a x - b^2 lambda with x(0) = x0, then set t = T"),
    FormulaQuestion(
        'example-2.2-limit', 'Example 2.2: give the limit of x(T) for c to infinity.', 'number',
        0.0, {}, (), 'the larger c is, the more a terminal state costs that is not at the origin'),
    FormulaQuestion(
        'example-2.2-limit-input', 'Example 2.2: give the limit of u(t) for c to infinity.',
        'formula of a, b, x0, t, T', '-2*a*exp(a*(2*T - t))*x0/(b*(exp(2*a*T) - 1))',
        {name: SCALAR[name] for name in ('a', 'b', 'x0', 'T')} | EARLY,
        ((0.0, 'x(T) vanishes, but c x(T) does not'),
         ('-2*a*x0/b*exp(-a*t)', 'this is the infinite horizon, T to infinity as well'),
         ('-2*a*exp(a*(2*T - t))*x0/(exp(2*a*T) - 1)', 'the division by b is missing')),
        'find the limit of c x(T) first'),
    FormulaQuestion(
        'example-2.3-time', "Example 2.3: x1' = x2, x2' = u, |u| <= 1. Give the minimum time [s] "
        'from (1, 0) to rest at 0.', 'number', 2.0, {},
        ((sqrt(2.0), 'at this time x1 is 0, but x2 is not: the input has to brake'),
         (1.0, 'this is the time of the switch')),
        'accelerate over half of the way, brake over the other half'),
    FormulaQuestion(
        'example-2.3-hamiltonian', 'Example 2.3: T is free. Give the value of '
        'H = 1 + lambda1 x2 + lambda2 u along the optimum.', 'number', 0.0, {},
        ((1.0, 'transversality for a free T is a condition on H(T). You have the condition of '
          'another problem, or left the cost 1 out of H'),
         (-1.0, 'this is the value without the cost L = 1; H contains L')),
        'H is constant, and a free final time is a condition on H(T)'),
    FormulaQuestion(
        'example-2.4-gain', "Example 2.4: x1' = x2, x2' = u, Qx = diag(q^2, 0), Qu = 1. Give the "
        'gain K of u = -K x.', '[k1, k2], formulas of q', (('q', 'sqrt(2*q)'),), POSITION_WEIGHT,
        ((('1/q', 'sqrt(2/q)'), 'this is printed in the book, and a misprint: it belongs to '
          'Qx = diag(1, 0), Qu = q^2. From P follows K = Qu^-1 B^T P, its second row'),
         (('sqrt(2*q**3)', 'q'), 'this is the first row of P: K = Qu^-1 B^T P is the second'),
         (('-q', '-sqrt(2*q)'), NEGATIVE),
         (('sqrt(q)', 'sqrt(2*sqrt(q))'), 'this is the gain for Qx = diag(q, 0); here it is q^2'),
         (('q**2', 'sqrt(2)*q'), 'this is the gain for Qx = diag(q^4, 0); here it is q^2')),
        'put K = (P12, P22) into the Riccati equation: P12^2 = q^2, P22^2 = 2 P12'),
    FormulaQuestion(
        'example-2.4-frequency', 'Example 2.4: give the natural frequency of the closed loop.',
        'formula of q', 'sqrt(q)', POSITION_WEIGHT,
        (('sqrt(1/q)', 'this is printed in the book, and a misprint'),
         ('q', 'this is the square of the frequency, the last coefficient of s^2 + k2 s + k1')),
        's^2 + k2 s + k1 = s^2 + 2 zeta omega0 s + omega0^2'),
    FormulaQuestion(
        'example-2.4-damping', 'Example 2.4: give the damping ratio of the closed loop.',
        'number', 1.0 / sqrt(2.0), {},
        ((sqrt(2.0), 'the coefficient of s is 2 zeta omega0'),),
        's^2 + k2 s + k1 = s^2 + 2 zeta omega0 s + omega0^2'),
    FormulaQuestion(
        'example-2.5-weight', 'Example 2.5: errors of 1 cm in x, 10 cm in y and 5 degrees in '
        'theta are equally bad. x has the weight 100, y the weight 1. Give the weight of theta, '
        'which is in radians.', 'number', (3.6 / math.pi)**2, {},
        ((2.0 * math.pi / 9.0, 'this is printed in the book, and a misprint: it is 40 degrees in '
          'radians'),
         (0.02**2, 'the angle is in degrees: 5 degrees are pi/36'),
         (3.6 / math.pi, 'a weight belongs to the square of an error'),
         ((math.pi / 3.6)**2, 'a weight is inverse to the square of the error that is allowed')),
        'the weight times the square of the error is the same for x, y and theta'),
    FormulaQuestion(
        'example-2.5-equilibrium', 'Example 2.5: give the forces (F1, F2) with which the aircraft '
        'of mass m hovers at theta = 0.', 'two formulas of m, g', ((0.0, 'm*g'),),
        {'m': (0.5, 5.0), 'g': (1.0, 10.0)},
        ((('m*g', 0.0), 'the forces are exchanged: F2 acts upwards, F1 sideways'),
         ((0.0, '-m*g'), 'the sign: F2 acts upwards, gravity downwards'),
         ((0.0, 'g'), "this is the acceleration; m y'' is a force"),
         ((0.0, 0.0), 'without a force the aircraft falls')),
        "x'' = 0, y'' = 0 and theta'' = 0"),
    FormulaQuestion(
        'example-2.5-gain', 'Example 2.5 with Qx = diag(100, 1, 2 pi/9, 0, 0, 0), Qu = 0.1 I: '
        'give the entry of K from y to F2. (At the equilibrium the vertical motion is decoupled.)',
        'number', sqrt(10.0), {},
        ((10.0, 'this is the square of the entry, 1/rho'),
         (sqrt(0.1), 'this is inverse: the smaller rho is, the larger are the forces'),
         (sqrt(1000.0), 'y has the weight 1, x has 100'),
         (-sqrt(10.0), NEGATIVE)),
        'for one input and Q = diag(q, 0), the first gain follows from k1^2 = q/rho'),
    FormulaQuestion(
        'example-2.6-costate', 'Example 2.6: H = 1 + lambda1 u1 + lambda2 u2 + lambda3 x2 u1. '
        "Give lambda2'.", 'formula of lam3, x2, u1', '-lam3*u1',
        {'lam3': (-2.0, 2.0), 'x2': (-2.0, 2.0), 'u1': (-1.0, 1.0)},
        (('lam3*x2', 'this is printed in the book, and a misprint: H has to be differentiated by '
          'x2'),
         ('lam3*u1', "the sign of the costate equation: lambda2' = -dH/dx2"),
         ('-lam3*x2*u1', 'H has to be differentiated by x2')),
        "lambda2' = -dH/dx2"),
    FormulaQuestion(
        'example-2.6-switching', 'Example 2.6: the optimal input is u1 = -sgn(s). Give s.',
        'formula of lam1, lam3, x2', 'lam1 + lam3*x2',
        {'lam1': (-2.0, 2.0), 'lam3': (-2.0, 2.0), 'x2': (-2.0, 2.0), 'u1': (-1.0, 1.0)},
        (('lam1 + lam3*x2*u1', 'this is printed in the book, and a misprint: u1 is on both sides'),
         ('lam1', 'x3 depends on u1 as well'),
         ('lam1 + lam3', "x3' = x2 u1: the factor x2 is missing")),
        's = dH/du1'),
    FormulaQuestion(
        'example-2.6-time', 'Example 2.6: give the minimum time from (0, 0, 0) to (rho, 0, 0).',
        'formula of rho', 'rho', {'rho': (0.5, 3.0)},
        (('2*rho', '|u1| <= 1, and nothing has to be at rest at the end'),
         ('2*sqrt(rho)', "this is the time of a double integrator, from rest to rest; here x1' = "
          'u1')),
        "x1' = u1 with |u1| <= 1"),
    FormulaQuestion(
        'example-2.6-line', 'Example 2.6: give the costates (lambda1, lambda2, lambda3) on this '
        'line.', 'three numbers', ((-1.0, 0.0, 0.0),), {},
        ((((1.0, 0.0, 0.0),), SIGN),
         (((0.0, 0.0, 0.0),), 'H = 1 + lambda1 u1 + ... vanishes, as T is free'),
         (((-1.0, 0.0, -1.0),), "lambda2' = -lambda3 u1 has to vanish with lambda2")),
        'lambda2 vanishes on the line, u1 = 1, and T is free'),
    FormulaQuestion(
        'example-2.6-singular', 'Example 2.6: which input does the minimum of H leave open on '
        'this line? Give its number i of ui.', '1 or 2', 2.0, {},
        ((1.0, 'the factor of u1 in H is lambda1 + lambda3 x2, which does not vanish here'),),
        'look for the input whose factor in H vanishes'),
    FormulaQuestion(
        'example-2.6-multiplier', 'Example 2.6: write H = lambda0 + lambda1 u1 + lambda2 u2 + '
        'lambda3 x2 u1. Which lambda0 >= 0 belongs to lambda = (-1, 0, 0)?', 'number', 1.0, {},
        ((0.0, 'this would be an abnormal extremal, as the book calls it; it is normal, and '
          'singular'),
         (-1.0, 'H vanishes, as T is free')),
        'H vanishes, as T is free'))
