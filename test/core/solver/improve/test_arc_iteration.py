# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arcs obtained from coarse paths, and the costs of coarse paths."""

import math

import casadi as ca
from obc_ros.core.solver.bench import build_bench, Task
from obc_ros.core.solver.nlp.meter import Meter
from obc_ros.core.solver.program_cache import ProgramCache
from obc_ros.core.solver.solve import solve
from obc_ros.core.solver.transcription.mesh import build_uniform_mesh
import problems
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar


@pytest.mark.parametrize('intervals', [16, 24])
def test_costs_of_coarse_paths_agree_after_replay(intervals: int):
    """
    Two discretisations of Rayleigh's problem agree in their inputs but not in their costs.

    With 16 intervals one cost is below the published minimum, which no input can attain. After
    integration under the same inputs the costs agree.
    """
    problem = problems.build('rayleigh_bounded')
    least = problems.read('rayleigh_bounded')['expected']['objective']
    costs, closed = [], []
    for stages in (0, 3):
        bench = build_bench(Task(problem, ProgramCache(problem), Meter()))
        line = bench.programs.guesser.line(problem, problem.final_time.value)
        outcome = bench.collocate(build_uniform_mesh(problem, intervals, stages), line)
        assert outcome.converged
        costs.append(outcome.objective - least)
        closed.append(bench.programs.integrator.closed(problem, outcome) - least)
    assert max(costs) > 10 * abs(min(costs))
    assert closed[0] == pytest.approx(closed[1], rel=0.03)
    assert min(closed) > 0


def fly_goddard(start):
    """
    Return the maximum height of Goddard's rocket and its three switching times.

    The arcs are full thrust, a singular arc, full thrust and zero thrust. The final time is
    free, so H = 0; along the singular arc lam' f0 = lam' f1 = lam' [f0, f1] = 0 for
    dz/dt = f0 + f1 u, so the determinant of the three vectors vanishes. This defines a surface
    in (h, v, m), on which u keeps the state. The arc begins where full thrust reaches the
    surface; the second arc of full thrust ends with the fuel. The duration of the singular arc
    is the only unknown; at 0.0262 its thrust would exceed 3.5.
    """
    z = ca.SX.sym('z', 3)
    u = ca.SX.sym('u')
    h, v, m = ca.vertsplit(z)
    f0 = ca.vertcat(v, -310 * v**2 * ca.exp(-500 * (h - 1)) / m - 1 / h**2, 0)
    f1 = ca.vertcat(0, 1 / m, -2)
    surface = ca.det(ca.horzcat(f0, f1, ca.jtimes(f1, z, f0) - ca.jtimes(f0, z, f1)))
    slope = ca.gradient(surface, z)
    rate = ca.Function('rate', [z, u], [f0 + f1 * u])
    off = ca.Function('off', [z], [surface])
    singular = ca.Function('singular', [z], [-ca.dot(slope, f0) / ca.dot(slope, f1)])

    def fly(start, thrust, stop=None, longest=1.0):
        if stop is not None:
            stop.terminal = True
        path = solve_ivp(lambda t, z: rate(z, thrust(z)).full().ravel(), (0, longest), start,
                         'DOP853', events=stop, rtol=1e-12, atol=1e-13)
        return path.t[-1], path.y[:, -1]

    def full(z):
        return 3.5

    begin, entry = fly(start, full, lambda t, z: float(off(z)))

    def finish(length):
        end, leave = fly(entry, singular, longest=length)
        rest, dry = fly(leave, full, lambda t, z: z[2] - 0.6)
        _, top = fly(dry, lambda z: 0.0, lambda t, z: z[1])
        return top[0], [begin, begin + end, begin + end + rest]

    best = minimize_scalar(lambda length: -finish(length)[0], bounds=(0.02, 0.026),
                           method='bounded', options={'xatol': 1e-6})
    return finish(best.x)


@pytest.mark.slow
def test_a_singular_arc_between_full_thrust_arcs_is_found():
    """Goddard's rocket with height and mass 1.001; a coarse path shows the arc as two jumps."""
    height, times = fly_goddard([1.001, 0, 1.001])
    problem = problems.build('goddard', initial_state={'h': 1.001, 'v': 0, 'm': 1.001})
    found = solve(problem)
    assert found.certified
    assert found.objective == pytest.approx(-height, abs=1e-9)
    assert found.switching_times == pytest.approx(times, abs=3e-4)


def drive_through_winding(lag: float, highest: float) -> tuple[float, float]:
    """
    Return the bang time and the least heat of a motor that turns by 1 within 1 s.

    th' = i, i' = (u - i)/lag, |u| <= highest, and the heat is the integral of i^2. The costate of
    th is constant and that of i vanishes, so that i = c after the bang, i(t) = highest
    (1 - exp(-t/lag)), has reached c.
    """
    def lasts(c):
        return -lag * math.log(1 - c / highest)

    c = brentq(lambda c: highest * lasts(c) - lag * c + c * (1 - lasts(c)) - 1, 0.5, 2.0,
               xtol=1e-14)
    t = lasts(c)
    charge, square = (lag / k * (1 - math.exp(-k * t / lag)) for k in (1, 2))
    return t, highest**2 * (t - 2 * charge + square) + c**2 * (1 - t)


@pytest.mark.parametrize('lag', [1 / 2000, 1 / 500])
def test_a_bang_much_shorter_than_an_interval_is_found(lag: float) -> None:
    """A fast winding: the bang lasts 0.03 ms of 1 s, an interval of the coarse mesh 63 ms."""
    time, heat = drive_through_winding(lag, 20.0)
    found = solve(problems.pose(
        {'th': 'i', 'i': f'(u - i)/{lag}'}, 'i**2', (0, 0), {'free': False, 'value': 1},
        terminal_constraints=['th - 1'], input_bounds={'u': [-20, 20]}))
    assert found.certified
    assert found.objective == pytest.approx(heat, rel=1e-9)
    assert found.switching_times == pytest.approx([time], rel=1e-5)


def complement(weight: float) -> tuple[float, float]:
    """
    Return the time of the switch, and the least cost, with a penalised complementarity.

    y' = 2 - s from -1 to t = 2; y = q - p with p, q >= 0. Without a penalty s = -1 while q = 0
    and s = 1 while p = 0. It pays to switch at y = -a < 0: 2 weight p is due until p = 0.
    """
    def cost(a):
        end = 2 - (1 - a) / 3 - a
        return (1 - a**3) / 9 + (a**3 + end**3) / 3 + weight * a**2 + (end - 5 / 3)**2

    a = minimize_scalar(cost, bounds=(0, 0.1), method='bounded', options={'xatol': 1e-12}).x
    return (1 - a) / 3, cost(a)


@pytest.mark.slow
def test_inputs_of_an_equality_change_their_bounds_one_after_the_other() -> None:
    """One of three inputs jumps; the other two meet their bounds 1 ms later, of 2 s."""
    weight = 1000.0
    time, cost = complement(weight)
    found = solve(problems.pose(
        {'y': '2 - s'}, f'y**2 + {weight}*(p*(s + 1) + q*(1 - s))', (-1,),
        {'free': False, 'value': 2}, inputs=['s', 'p', 'q'], terminal_cost='(y - 5/3)**2',
        input_bounds={'s': [-1, 1], 'p': [0, 10], 'q': [0, 10]},
        path_constraints=[{'expr': 'q - p - y', 'lower': 0, 'upper': 0}]), time_limit=600)
    assert found.certified
    assert found.objective == pytest.approx(cost, rel=1e-8)
    assert found.switching_times[0] == pytest.approx(time, rel=1e-6)
