# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A plugin of pytest for `refusals`: leaves out one check of the explanation or one proof.

``pytest -p _without_check`` reads its name from the variable OBC_ROS_WITHOUT, '' for none, and
writes to the file in OBC_ROS_GIVEN the names of those that gave a reason in each test, and the
tests that failed.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import wraps
import json
import os
from pathlib import Path
from typing import Any

from _running_test import find_running_test
from obc_ros.core.ocp.problem import Problem
from obc_ros.core.solver.diagnosis import explanation
from obc_ros.core.solver.proofs import contradictions
import pytest

_given: dict[str, set[str]] = {}
_failed: list[str] = []


def name_proof(proof: Callable[..., Any]) -> str:
    """Return the name of a proof of CONTRADICTIONS."""
    return f'proof: {proof.__name__.strip("_").replace("_", " ")}'


def _note(name: str) -> None:
    if test := find_running_test():
        _given.setdefault(test, set()).add(name)


def _noting_check(check: explanation.Check) -> explanation.Check:
    """Return a check that notes its name when it gives a reason."""
    @wraps(check.run)
    def run(case: explanation.Unsolved) -> explanation.Reason | None:
        reason = check.run(case)
        if reason:
            _note(check.name)
        return reason

    return replace(check, run=run)


def _noting_proof(proof: Callable[[Problem], Iterator[str]]
                  ) -> Callable[[Problem], Iterator[str]]:
    """Return a proof that notes its name when it yields a sentence."""
    @wraps(proof)
    def run(problem: Problem) -> Iterator[str]:
        for sentence in proof(problem):
            _note(name_proof(proof))
            yield sentence

    return run


CHECKS = tuple(check.name for check in explanation.CHECKS)
PROOFS = tuple(map(name_proof, contradictions.CONTRADICTIONS))


def _install(without: str) -> None:
    """Leave out one check or proof, and note the others."""
    explanation.CHECKS = tuple(
        _noting_check(check) for check in explanation.CHECKS if check.name != without)
    contradictions.CONTRADICTIONS = () if without == 'contradiction' else tuple(
        _noting_proof(proof) for proof in contradictions.CONTRADICTIONS
        if name_proof(proof) != without)


def pytest_sessionstart() -> None:
    """Leave out the check."""
    _install(os.environ['OBC_ROS_WITHOUT'])


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep the name of a test that fails."""
    if report.failed:
        _failed.append(report.nodeid.partition('::')[2])


def pytest_sessionfinish() -> None:
    """Write what was noted."""
    Path(os.environ['OBC_ROS_GIVEN']).write_text(json.dumps(
        [{test: sorted(names) for test, names in _given.items()}, _failed]), encoding='utf-8')
