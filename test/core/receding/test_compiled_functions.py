# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled functions: equal results, the cache, a damaged file, no compiler, no directory."""

from pathlib import Path
import shutil

import casadi as ca
from obc_ros.core.receding.step_kernel import compile_function, find_cache_directory
import pytest

needs_compiler = pytest.mark.skipif(shutil.which('cc') is None, reason='there is no C compiler')


def wave() -> ca.Function:
    """Return sin(x) x."""
    x = ca.SX.sym('x')
    return ca.Function('wave', [x], [ca.sin(x) * x])


@needs_compiler
def test_the_compiled_function_is_kept_and_equal(tmp_path: Path) -> None:
    """The second call loads the file of the first."""
    first, second = (compile_function(wave(), tmp_path) for _ in range(2))
    assert first.compiled and 'from the cache' not in first.words
    assert second.compiled and 'from the cache' in second.words
    assert float(second.function(0.7)) == pytest.approx(float(wave()(0.7)), rel=1e-15)


@needs_compiler
def test_a_damaged_file_is_built_again(tmp_path: Path) -> None:
    """Its hash differs from the one that was written."""
    compile_function(wave(), tmp_path)
    library = next(tmp_path.glob('*.so'))
    library.unlink()
    library.write_bytes(b'no library')
    found = compile_function(wave(), tmp_path)
    assert found.compiled and 'from the cache' not in found.words


def test_without_a_compiler_the_function_is_interpreted(monkeypatch: pytest.MonkeyPatch,
                                                        tmp_path: Path) -> None:
    """The sentence says why."""
    monkeypatch.setenv('PATH', str(tmp_path))
    found = compile_function(wave(), tmp_path)
    assert not found.compiled and 'no C compiler' in found.words
    assert float(found.function(0.0)) == 0.0


@needs_compiler
def test_without_a_directory_the_function_is_interpreted(tmp_path: Path) -> None:
    """A file is where the directory should be."""
    (tmp_path / 'file').write_text('')
    found = compile_function(wave(), tmp_path / 'file')
    assert not found.compiled and found.words.startswith('interpreted: ')


def test_the_cache_is_where_the_user_has_it(monkeypatch: pytest.MonkeyPatch,
                                            tmp_path: Path) -> None:
    """A relative XDG_CACHE_HOME is ignored, as its specification says."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    assert find_cache_directory() == tmp_path / 'obc_ros'
    monkeypatch.setenv('XDG_CACHE_HOME', 'relative')
    assert find_cache_directory() == Path.home() / '.cache' / 'obc_ros'
