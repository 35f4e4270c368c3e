# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
CasADi functions compiled to machine code, kept in a directory.

The name of a file is a hash of the C code, of the version of CasADi and of the machine. Beside it
is the hash of the file itself, so that a damaged one is not loaded. A file of another user is
built again.
"""

from dataclasses import dataclass
import hashlib
import os
from pathlib import Path
import platform
import shutil
import subprocess
import tempfile

import casadi as ca

# -O2 takes ten times as long for a plant of twelve states, and the code is not faster.
_FLAGS = ('-O1', '-shared', '-fPIC')
_LONGEST = 120.0   # [s] for the compiler


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
