# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Answers do not hang on the last bits of arithmetic: the short form of benchmarks/rounding.py."""

import json
import subprocess
import sys

import _rounding  # of benchmarks/
import numpy as np
from obc_ros.core.solver.transcription.mesh import Path
import problems
import pytest
import rounding  # of benchmarks/

NAMES = 'bryson_denham', 'di_mintime_rest', 'zermelo_shear', 'lq_scalar_unit', 'catenary'


@pytest.mark.slow
def test_quick_problems_are_answered_alike_however_arithmetic_rounds():
    variants = [rounding.Variant(rounding.OWN, 0), rounding.Variant('Haswell', 0),
                rounding.Variant('Nehalem', 0), rounding.Variant(rounding.OWN, 1)]
    found = rounding.verdicts(NAMES, variants, 60)
    for name in NAMES:
        assert [each.status for each in found[name].values()] == ['solved'] * len(variants)
        assert list(rounding.differences(found[name])) == []


def test_what_differs_is_told():
    first, other = rounding.Variant(rounding.OWN, 0), rounding.Variant('Nehalem', 0)

    def told(one, two):
        return [said for _, said in rounding.differences({first: one, other: two})]

    solved = rounding.Verdict('solved', 2.0)
    assert told(solved, rounding.Verdict('solved', 2.0 + 1e-6)) == []
    assert told(solved, rounding.Verdict('solved', 2.0 + 1e-5)) == ['cost 2 -> 2.00001']
    assert told(solved, rounding.Verdict('infeasible', np.nan)) == ['solved -> infeasible']
    assert told(solved, rounding.Verdict('timed_out', 3.0)) == []
    assert told(rounding.Verdict('died with -6: Abort', np.nan), solved) == [
        'died with -6: Abort', 'died with -6: Abort -> solved']


def test_every_number_of_a_statement_is_changed_a_little():
    problem = problems.build('zermelo_shear')
    changed = _rounding.Changed(1).problem(problem)
    assert changed.structure == problem.structure
    for name in ('p_value', 'x0', 'u_upper'):
        one, other = (getattr(each, name) for each in (problem, changed))
        finite = np.isfinite(one) & (one != 0)
        assert other[~finite].tolist() == one[~finite].tolist()
        assert np.all(one[finite] != other[finite]) or not finite.any()
        assert other[finite] == pytest.approx(one[finite], rel=1.1e-12)


def test_a_kernel_is_chosen_by_the_environment():
    """Or else the benchmark compares a kernel with itself."""
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
def test_the_side_of_a_jump_does_not_hang_on_the_last_bit_of_a_time(last_bits):
    t = np.array([0, 0.1 + 0.2, 1])
    path = Path(t, np.zeros((3, 1)), np.zeros((2, 0, 1)), np.array([[1.0], [3]]),
                np.array([[1.0], [3]]), np.array([1.0]))
    time = np.array([0.3 * (1 + last_bits)])
    assert path.inputs_at(time, after=False) == 1
    assert path.inputs_at(time, after=True) == 3
