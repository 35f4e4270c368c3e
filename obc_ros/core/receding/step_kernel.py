# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The numbers of a step: its iterate, the program about it, and what the program answers.

All functions work on one memory, so that a number is neither copied nor converted between them.
They are compiled to machine code, which is kept in a directory, see
docs/receding_horizon_theory.md. A file of another user is built again.
"""

from collections.abc import Callable
from dataclasses import dataclass
import hashlib
import math
import os
from pathlib import Path
import platform
import shutil
import subprocess
import tempfile
from typing import Any

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.receding.horizon_program import HorizonProgram

# -O2 takes ten times as long for a plant of twelve states, and the code is not faster.
_FLAGS = ('-O1', '-shared', '-fPIC')
_LONGEST = 120.0   # [s] for the compiler

@dataclass(frozen=True, eq=False)
class HorizonMotion:
    """
    A motion of the model with admissible inputs.

    :ivar E, V: (N + 1, n) and (N, m), errors about the set point, and inputs less those of the set
        point.
    :ivar cost: without the penalty.
    :ivar excess, worst: (r,), the sum and the largest of the excesses of each soft row.
    """

    E: Array
    V: Array
    cost: float
    excess: Array
    worst: Array


class BufferedFunction:
    """
    A function whose inputs and outputs are arrays of a shared memory.

    An output is the input of another function if both have the same name.

    :param function: it must not raise an exception, which would end the process.
    :param memory: the arrays by name, each of the nonzeros in the order of CasADi (by columns).
        The arrays of further names are added, with zeros.
    :raises ValueError: if an array has another size than the input or the output of its name.
    """

    def __init__(self, function: ca.Function, memory: dict[str, Array]) -> None:
        self._buffer, self._evaluate = function.buffer()
        self._places: list[tuple[Callable[..., None], int, memoryview]] = []
        for count, name_of, size_of, put in (
                (function.n_in(), function.name_in, function.nnz_in, self._buffer.set_arg),
                (function.n_out(), function.name_out, function.nnz_out, self._buffer.set_res)):
            for place in range(count):
                array = memory.setdefault(name_of(place), np.zeros(size_of(place)))
                if array.size != size_of(place):
                    raise ValueError(f'{name_of(place)} of {function.name()}: {array.size} '
                                     f'numbers; wanted {size_of(place)}')
                if array.size:
                    self._places.append((put, place, array.data))

    def run(self) -> None:
        """Compute the outputs."""
        for put, place, array in self._places:   # HPIPM uses the list of addresses for itself
            put(place, array)
        self._evaluate()


class StepKernel:
    """
    The functions of a problem and their memory.

    :ivar words: a sentence on the compilation.
    :ivar E, V: (N + 1, n) and (N, m), the iterate, to be written before `linearize` and `follow`.
    :ivar lam, mu: (N, n) and (N, r), the multipliers in the Hessian.
    """

    def __init__(self, program: HorizonProgram, directory: Path | None, compiled: bool) -> None:
        self._program = program
        functions = [program.linearize, program.follow]
        self.words = 'interpreted: as asked'
        if compiled:
            found = [compile_function(each, directory) for each in functions]
            functions = [each.function for each in found]
            self.words = '; '.join(dict.fromkeys(each.words for each in found))
        pattern = {'h': program.hessian_pattern, 'a': program.pattern[0]}
        solver = ca.conic('qp', 'hpipm', pattern, {**_OPTIONS, **program.options})
        memory: dict[str, Array] = {}
        self._linearize, self._follow, self._solve = (
            BufferedFunction(each, memory) for each in (*functions, solver))
        self._memory = memory
        self._name_arrays()

    def _name_arrays(self) -> None:
        """Name the parts of the memory by their shapes."""
        memory = self._memory
        N, n, m, r, last = self._program.sizes
        shapes = {'E': (N + 1, n), 'V': (N, m), 'lam': (N, n), 'mu': (N, r), 'excess': (N, r),
                  'moved': (N + 1, n), 'applied': (N, m), 'shifts': (N + 1, n)}
        (self.E, self.V, self.lam, self.mu, self._excess, self._moved, self._applied,
         self._shifts) = (memory[name].reshape(shape) for name, shape in shapes.items())
        stages = memory['x'][:N * (n + m + r)].reshape(N, n + m + r)
        self._found = stages[:, :n], memory['x'][len(memory['x']) - n - last:][:n], \
            stages[:, n:n + m]
        one_sided, box = self._program.one_sided, self._program.box
        memory['lbx'][:], memory['ubx'][:] = box
        # The least and the largest multiplier: 0 if the limit is infinite.
        self._signs = (np.where(one_sided > 0.0, 0.0, -np.inf),
                       np.where(one_sided < 0.0, 0.0, np.inf))
        self._box_signs = tuple(np.where(np.isinf(each), 0.0, sign) for each, sign in zip(
            box, (-np.inf, np.inf), strict=True))
        self._box_signs[0][:n], self._box_signs[1][:n] = -np.inf, np.inf   # e_0 is given

    def begin(self, e0: Array, shifts: Array) -> None:
        """Take the error at the start, shape (n,), and the moves of the set point (N + 1, n)."""
        memory, n = self._memory, len(e0)
        self._shifts[:] = shifts
        memory['e0'][:] = memory['lbx'][:n] = memory['ubx'][:n] = e0
        memory['lam_a'][:] = memory['lam_x'][:] = 0.0

    def follow(self) -> HorizonMotion | None:
        """Return the motion with the inputs V about E; None if it is not finite."""
        self._follow.run()
        memory = self._memory
        end = memory['excess_last']
        cost = float(memory['cost'][0])
        of = list(self._program.problem.soft.of_states)
        excess, worst = self._excess.sum(axis=0), self._excess.max(axis=0, initial=0.0)
        excess[of] += end
        worst[of] = np.maximum(worst[of], end)
        if not (math.isfinite(cost) and np.isfinite(excess).all()
                and np.isfinite(self._moved).all()):
            return None
        return HorizonMotion(self._moved.copy(), self._applied.copy(), cost, excess, worst)

    def linearize(self, penalties: Array) -> None:
        """State the program about the iterate, with penalties (r,) of the excesses."""
        self._memory['sigma'][:] = penalties
        self._linearize.run()

    def solve(self) -> bool:
        """Solve the program; return whether its answer is finite, which is the next iterate."""
        memory = self._memory
        if not all(np.isfinite(memory[name]).all() for name in ('h', 'g', 'a', 'gaps', 'x0')):
            return False
        self._solve.run()
        lam_a, lam_x = memory['lam_a'], memory['lam_x']
        # The solver takes infinite limits as finite ones, with multipliers.
        np.clip(lam_a, *self._signs, out=lam_a)
        np.clip(lam_x, *self._box_signs, out=lam_x)
        if not all(np.isfinite(memory[name]).all() for name in ('x', 'lam_a', 'lam_x')):
            lam_a[:] = lam_x[:] = 0.0
            return False
        self.E[:-1], self.E[-1], self.V[:] = self._found
        return True

    def take_multipliers(self) -> None:
        """Take the multipliers of the program for the Hessian of the next one."""
        model, soft, which = self._program.multiplier_rows
        lam_a = self._memory['lam_a']
        self.lam[:] = lam_a[model]
        self.mu[:] = 0.0
        for column, row in enumerate(which):
            self.mu[:, row] += lam_a[soft[:, column]]

    @property
    def gap(self) -> float:
        """Return the largest gap between the iterate and the model, relative to its size."""
        memory = self._memory
        return _find_largest(memory['gaps']) / (1.0 + _find_largest(memory['E']))

    def measure_residual(self) -> float:
        """
        Return the relative residual of the optimality conditions of the iterate.

        With its own linearization and the multipliers of the program before: the gradient of the
        Lagrangian, and the products of multipliers and distances from limits, each over 1 + the
        largest term of its sum; the gaps of the model and the distance from the bounds.
        """
        memory = self._memory
        size = 1.0 + max(_find_largest(memory['steep']), _find_largest(memory['lam_a']))
        z = memory['x0']
        outside = float(np.maximum(memory['lbx'] - z, z - memory['ubx']).max())
        value = 1.0 + abs(float(memory['value'][0]))
        return float(np.max([   # NaN if one is
            _find_largest(memory['slope']) / size, _find_largest(memory['products']) / value,
            self.gap, outside]))


def _find_largest(values: Array) -> float:
    """Return the largest absolute value; NaN if one is."""
    return float(np.abs(values).max(initial=0.0))


_OPTIONS: dict[str, Any] = {
    'print_time': False, 'inf': 1e5, 'error_on_fail': False, 'inputs_check': False, 'hpipm': {
        'iter_max': 60, 'mode': 'speed', 'res_g_max': 1e-8, 'res_b_max': 1e-8,
        'res_d_max': 1e-8, 'res_m_max': 1e-8}}


@dataclass(frozen=True)
class CompiledFunction:
    """A function, whether it is compiled, and a sentence on it."""

    function: ca.Function
    compiled: bool
    words: str


def find_cache_directory() -> Path:
    """Return $XDG_CACHE_HOME/obc_ros, by default ~/.cache/obc_ros."""
    given = os.environ.get('XDG_CACHE_HOME', '')
    base = Path(given) if os.path.isabs(given) else Path(os.path.expanduser('~')) / '.cache'
    return base / 'obc_ros'


def compile_function(function: ca.Function, directory: Path | None = None) -> CompiledFunction:
    """
    Compile a function, or load it if it was compiled before.

    :param function: its operations must have C code.
    :param directory: where it is kept; default: `find_cache_directory`.
    :return: the function as given if it cannot be compiled; the sentence says why.
    """
    compiler = shutil.which('cc')
    if compiler is None:
        return CompiledFunction(function, False, 'interpreted: there is no C compiler (cc)')
    kept = find_cache_directory() if directory is None else directory
    try:
        kept.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.TemporaryDirectory(dir=kept) as folder:
            return _compile(function, compiler, kept, Path(folder))
    except (OSError, RuntimeError, subprocess.SubprocessError) as error:
        first = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        return CompiledFunction(function, False, f'interpreted: {first}')


def _compile(function: ca.Function, compiler: str, kept: Path, folder: Path) -> CompiledFunction:
    """Return the loaded function; raise OSError or SubprocessError if that cannot be done."""
    name = function.name()
    generator = ca.CodeGenerator(f'{name}.c')
    generator.add(function)
    generator.generate(f'{folder}{os.sep}')
    source = folder / f'{name}.c'
    key = hashlib.sha256('\n'.join((source.read_text(), ca.CasadiMeta.version(),
                                    platform.platform(),
                                    platform.machine(), *_FLAGS)).encode()).hexdigest()[:32]
    library = kept / f'{name}_{key}.so'
    sound = _is_sound(library)
    if not sound:
        built = folder / 'built.so'
        subprocess.run([compiler, *_FLAGS, str(source), '-o', str(built), '-lm'], check=True,
                       capture_output=True, timeout=_LONGEST)
        digest = folder / 'built.sha256'
        digest.write_text(_hash(built))
        os.replace(digest, library.with_suffix('.sha256'))
        os.replace(built, library)
    found = ca.external(name, str(library))
    return CompiledFunction(found, True, f'compiled: {library.name}'
                                         f'{", from the cache" if sound else ""}')


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _is_sound(library: Path) -> bool:
    """Return whether a file is there, is ours and is what was written."""
    try:
        ours = library.stat().st_uid == os.getuid()
        return ours and library.with_suffix('.sha256').read_text() == _hash(library)
    except (OSError, UnicodeDecodeError):
        return False
