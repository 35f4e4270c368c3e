# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sensitivity of solutions to rounding: a short form of benchmarks/rounding.py."""

import json
import subprocess
import sys

import _rounding  # of benchmarks/
import numpy as np
from obc_ros.core.solver.transcription.mesh import Path
import problems
import pytest
import rounding  # of benchmarks/

NAMES = 'bryson_denham', 'di_mintime_rest', 'zermelo_shear'


@pytest.mark.slow
def test_results_agree_between_roundings():
    variants = [rounding.Variant(rounding.OWN, 0), rounding.Variant('Haswell', 0),
                rounding.Variant('Nehalem', 0), rounding.Variant(rounding.OWN, 1)]
    found = rounding.verdicts(NAMES, variants, 60)
    for name in NAMES:
        assert [each.status for each in found[name].values()] == ['solved'] * len(variants)
        assert list(rounding.differences(found[name])) == []


def test_differences_between_results_are_reported():
    first, other = rounding.Variant(rounding.OWN, 0), rounding.Variant('Nehalem', 0)

    def reported(one, two):
        return [text for _, text in rounding.differences({first: one, other: two})]

    solved = rounding.Verdict('solved', 2.0)
    assert reported(solved, rounding.Verdict('solved', 2.0 + 1e-6)) == []
    assert reported(solved, rounding.Verdict('solved', 2.0 + 1e-5)) == ['cost 2 -> 2.00001']
    assert reported(solved, rounding.Verdict('infeasible', np.nan)) == ['solved -> infeasible']
    assert reported(solved, rounding.Verdict('timed_out', 3.0)) == []
    assert reported(rounding.Verdict('died with -6: Abort', np.nan), solved) == [
        'died with -6: Abort', 'died with -6: Abort -> solved']


def test_every_number_of_a_problem_is_perturbed():
    problem = problems.build('zermelo_shear')
    perturbed = _rounding.Changed(1).problem(problem)
    assert perturbed.structure == problem.structure
    for name in ('p_value', 'x0', 'u_upper'):
        one, other = (getattr(each, name) for each in (problem, perturbed))
        finite = np.isfinite(one) & (one != 0)
        assert other[~finite].tolist() == one[~finite].tolist()
        assert np.all(one[finite] != other[finite]) or not finite.any()
        assert other[finite] == pytest.approx(one[finite], rel=1.1e-12)


def test_the_environment_selects_the_blas_kernel():
    """Otherwise the benchmark would compare a kernel with itself."""
    kernels = {kernel: subprocess.run(
        [sys.executable, '-c', (
            'import json, numpy as np\nr = np.random.default_rng(0)\n'
            'print(json.dumps((r.standard_normal((40, 300))'
            ' @ r.standard_normal((300, 40))).ravel().tolist()))')],
        env={'OPENBLAS_CORETYPE': kernel}, capture_output=True, text=True, check=True).stdout
        for kernel in ('Haswell', 'Nehalem')}
    one, other = (np.array(json.loads(text)) for text in kernels.values())
    assert one == pytest.approx(other, rel=1e-9, abs=1e-12)
    assert np.any(one != other)


@pytest.mark.parametrize('last_bits', [-2e-16, 0, 2e-16])
def test_the_side_of_a_jump_does_not_depend_on_rounding(last_bits):
    t = np.array([0, 0.1 + 0.2, 1])
    path = Path(t, np.zeros((3, 1)), np.zeros((2, 0, 1)), np.array([[1.0], [3]]),
                np.array([[1.0], [3]]), np.array([1.0]))
    time = np.array([0.3 * (1 + last_bits)])
    assert path.inputs_at(time, after=False) == 1
    assert path.inputs_at(time, after=True) == 3
