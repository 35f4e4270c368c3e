# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The starts, in the order in which they are tried in their stage.

A new start is a file and a line in STARTS. Two sources of initial guesses are called directly: the
lines and paths of inputs with which every search begins (`Guesser.starts`), between which the
others are placed; and a solved neighbour (`neighbour`), whose result is a finished candidate.
"""

import numpy as np
from obc_ros.core.solver.bench import Bench
from obc_ros.core.solver.starts.cross_entropy import (
    ends_at_target,
    interleave_rollouts,
    may_interleave,
    start_from_rollouts,
)
from obc_ros.core.solver.starts.final_time_windows import find_other_lengths, has_other_lengths
from obc_ros.core.solver.starts.horizon_continuation import continue_horizon, has_open_end
from obc_ros.core.solver.starts.obstacle_homotopy import has_obstacles, start_around
from obc_ros.core.solver.starts.start import Known, Proposal, Start, StartPool, StartStage
from obc_ros.core.solver.transcription.mesh import label_paths


def _scatter_lines(bench: Bench, pool: StartPool, known: Known) -> Proposal:
    return Proposal(rest=bench.programs.guesser.scattered(
        bench.problem, bench.programs.integrator, pool.rest, abs(known.floor)))


STARTS = (
    Start('path around obstacles', StartStage.FIRST_OUTCOME,
          'there are path constraints that are nonlinear in x and free of u',
          has_obstacles, start_around),
    Start('horizon continuation', StartStage.SECOND_MESH,
          'the final time is fixed, the end is free and the problem is not convex',
          has_open_end, continue_horizon),
    Start('cross-entropy search', StartStage.LAST_RESORT,
          'there are terminal constraints and no initial guess led to a path',
          ends_at_target, start_from_rollouts),
    Start('line to another final state', StartStage.MULTISTART,
          'the cost may have several local minima in the states',
          lambda _, known: known.uneven, _scatter_lines),
    Start('another final time', StartStage.MULTISTART,
          'the final time is free, and the cost depends on more than it',
          has_other_lengths, find_other_lengths),
    Start('cross-entropy rollout', StartStage.MULTISTART,
          'the cost has one local minimum in the states, or the end is free',
          may_interleave, interleave_rollouts))


def try_starts(stage: StartStage, bench: Bench, pool: StartPool, known: Known) -> Proposal:
    """
    Try the starts of a stage in turn, until one has solved the problem on its own mesh.

    Initial guesses are added to the pool. Return the outcomes if there are any, and the number of
    initial guesses that are worth a try.
    """
    wanted = 0
    for start in STARTS:
        if start.stage is not stage or not start.applies(bench, known):
            continue
        with bench.trace.attempt(start.name) as attempt:
            made = start.run(bench, pool, known)
            attempt.end(*made.judge(), cost=min(
                (outcome.objective for outcome in made.outcomes), default=np.nan))
        if made.rest is not None:
            pool.replace_rest(label_paths(made.rest, start.name))
        if made.first is not None:
            pool.put_first(label_paths(made.first, start.name))
        wanted += made.wanted
        if made.outcomes:
            return Proposal(made.outcomes, wanted=wanted)
    return Proposal(wanted=wanted)
