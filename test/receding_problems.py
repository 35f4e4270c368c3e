# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Receding horizons of statements with a plant of their own, as mpc_node takes problem files."""

from collections.abc import Mapping
from typing import Any

from obc_ros.core.ocp.statement import build_problem
from obc_ros.core.receding.formulation import RecedingProblem, state_receding_problem
from obc_ros.core.receding.restatement import check_restatable, restate_problem
from obc_ros.core.systems.file import build_system


def make_receding(statement: Mapping[str, Any], horizon: int, period: float) -> RecedingProblem:
    """Return the receding horizon of a statement, with `horizon` periods [s]."""
    problem = build_problem(statement)
    check_restatable(problem, statement)
    system = build_system(statement)
    taken = restate_problem(problem, statement, system)
    return state_receding_problem(
        system, horizon=horizon, period=period,
        weights={'Qx': taken.Qx, 'Qu': taken.Qu, 'cross': taken.cross},
        setpoint=taken.setpoint, setpoint_input=taken.setpoint_input,
        limits={key: statement[key] for key in ('state_bounds', 'input_bounds', 'path_constraints')
                if key in statement})
