# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A plugin of pytest for `baseline`: records every solution and every regulator that tests compute.

``pytest -p _recorder`` writes them to the file in the variable OBC_ROS_RECORD. The name of a
record is that of its test with the number of the call.
"""

from collections import Counter
from collections.abc import Callable
from functools import wraps
import json
import os
from pathlib import Path
import time
from typing import Any

from _running_test import find_running_test
import numpy as np
from obc_ros.core.lqr import lqr as regulators
from obc_ros.core.solver import solve as solver
from obc_ros.core.solver.diagnosis import explanation as explaining
from obc_ros.core.text.errors import ObcError

MOST = 20  # largest number of calls of one test: a property test has hundreds of examples

_records: dict[str, dict[str, Any]] = {}
_calls: Counter[str] = Counter()


def answer(found: Any) -> dict[str, Any]:
    """Return the compared fields of a Solution."""
    return {
        'verdict': found.status.name.lower(),
        'cost': float(found.objective) if found.t.size else None,
        'certificate': found.certificate.residuals if found.certificate else None,
        'message': found.message}


def regulator(design: Any) -> dict[str, Any]:
    """Return the compared fields of an LqrDesign."""
    return {'verdict': 'designed', 'cost': float(np.trace(design.P)), 'certificate': None,
            'message': ''}


def reason(found: Any) -> dict[str, Any]:
    """Return the compared fields of the Reason why a problem has no solution."""
    verdict = 'unknown' if found is None else 'infeasible' if found.infeasible else 'explained'
    return {'verdict': verdict, 'cost': None, 'certificate': None,
            'message': found.sentence if found else ''}


def recorded(function: Callable[..., Any], record: Callable[[Any], dict[str, Any]]
             ) -> Callable[..., Any]:
    """Return a function that also records its results and the errors of this package."""
    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        begun, known = time.process_time(), {'verdict': 'failed', 'cost': None,
                                             'certificate': None, 'message': ''}
        try:
            result = function(*args, **kwargs)
            known = record(result)
            return result
        except ObcError as error:
            known |= {'verdict': 'refused', 'message': str(error)}
            raise
        finally:
            test = find_running_test()
            _calls[test] += 1
            if test and _calls[test] <= MOST:
                _records[f'{test}#{_calls[test]}'] = {
                    **known, 'time': time.process_time() - begun}

    return call


solver.solve = recorded(solver.solve, answer)
explaining.explain = recorded(explaining.explain, reason)
regulators.lqr = recorded(regulators.lqr, regulator)
regulators.dlqr = recorded(regulators.dlqr, regulator)


def pytest_sessionfinish() -> None:
    """Write the records."""
    Path(os.environ['OBC_ROS_RECORD']).write_text(json.dumps(_records), encoding='utf-8')
