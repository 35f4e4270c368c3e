# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Figures of the documentation that are older than the code that they measure.

A row or a paragraph names a benchmark, then the commit and the day of its figures::

    | first answer | 0.70 ms | `obc bench time_optimal` at `314ba90e` of 2026-11-22 |

A commit without a benchmark belongs to the benchmark that was named last. The code of a benchmark
is what its script imports, starts, or names as a module, and all that this imports.
"""

import ast
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
import re
import shutil
import subprocess
import sys

import timing

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r'^\|.*|(?:^[^|\n].*\n)+', re.MULTILINE)   # a row of a table, or a paragraph
NAMES_OR_COMMIT = re.compile(r'obc bench((?: \w+)+)|benchmarks/(\w+)\.py|'
                             r'\bat `([0-9a-f]{7,40})` of (\d{4}-\d\d-\d\d)\b')


@dataclass(frozen=True)
class Figure:
    """Where it stands, its benchmark, its commit and day; '' for what is not given."""

    page: str
    line: int
    benchmark: str
    commit: str = ''
    day: str = ''


def main(root: Path = ROOT) -> int:
    """Print the figures that are older than their code; return 1 if a figure is malformed."""
    timing.arguments('figures of the documentation that are older than the code that they measure')
    if not ((root / '.git').exists() and shutil.which('git')):
        print('The age of figures is known only in a clone of the repository, with git.')
        return 0
    if faults := list(find_faults(root)):
        print('\n'.join(faults), file=sys.stderr)
        return 1
    places = defaultdict(list)
    for each in read_figures(root):
        places[each.page, each.benchmark, each.commit, each.day].append(str(each.line))
    rows = []
    for (page, benchmark, commit, day), lines in places.items():
        if later := find_later(benchmark, commit, root):
            rows.append((f'{page}:{",".join(lines)}', benchmark, f'{commit} of {day}', len(later),
                         later[0]))
    timing.table(f'{len(rows)} of {len(places)} results are older than their code', (
        'page', 'benchmark', 'measured at', 'changes since', 'the last of them'), rows)
    return 0


def read_figures(root: Path = ROOT) -> Iterator[Figure]:
    """Yield the figures of the README and of docs/, and those of rows without a commit."""
    docs = root / 'docs'
    for page in (root / 'README.md', *sorted(docs.rglob('*.md'))):
        name = str(page.relative_to(docs if page.is_relative_to(docs) else root))
        text, named = page.read_text(encoding='utf-8'), ['']
        for block in BLOCK.finditer(text):
            line, waiting = text.count('\n', 0, block.start()) + 1, list[str]()
            for names, script, *commit in NAMES_OR_COMMIT.findall(' '.join(block[0].split())):
                if names or script:
                    named = waiting = [*waiting, *names.split(), *script.split()]
                else:
                    yield from (Figure(name, line, each, *commit) for each in named)
                    waiting = []
            if block[0].startswith('|'):
                yield from (Figure(name, line, each) for each in waiting)


def find_faults(root: Path = ROOT) -> Iterator[str]:
    """Yield in words what is wrong with figures."""
    for each in read_figures(root):
        if not (root / 'benchmarks' / f'{each.benchmark}.py').is_file():
            yield f"{each.page}:{each.line}: no benchmark '{each.benchmark}'"
        elif not each.commit:
            yield f'{each.page}:{each.line}: no commit and day of {each.benchmark}'


def find_later(benchmark: str, commit: str, root: Path) -> list[str]:
    """Return the commits after `commit` that changed the code of a benchmark, newest first."""
    done = subprocess.run(
        ['git', 'log', '--format=%h of %cs: %s', f'{commit}..HEAD', '--',
         *find_code(root / 'benchmarks' / f'{benchmark}.py', root)],
        cwd=root, capture_output=True, text=True, check=False)
    return ['unknown commit'] if done.returncode else done.stdout.splitlines()


def find_code(script: Path, root: Path) -> set[Path]:
    """Return the files of the package that a script uses."""
    found, waiting = set[Path](), [script]
    while waiting:
        if (path := waiting.pop()) not in found:
            found.add(path)
            waiting += find_used(path, root)
    return {path for path in found if path.is_relative_to(root / 'obc_ros')}


@cache
def find_used(path: Path, root: Path) -> list[Path]:
    """Return the files of the package and of benchmarks/ that a file imports, starts or names."""
    text = path.read_text(encoding='utf-8')
    names = set(re.findall(r"'(obc_ros\.[\w.]+)'", text))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            names |= {f'{node.module}', *(f'{node.module}.{each.name}' for each in node.names)}
        elif isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
    if path.parent == root / 'benchmarks':
        names |= {f'benchmarks.{name}' for name in {*names, *re.findall(r"'(\w+)\.py'", text)}}
        commands = dict(re.findall(r'^(\w+) = "([\w.]+):main"',
                                   (root / 'pyproject.toml').read_text(encoding='utf-8'), re.M))
        names |= {commands[word] for word in re.findall(r"'(\w+)'", text) if word in commands}
    places = [root / name.replace('.', '/') for name in names
              if name.startswith(('obc_ros.', 'benchmarks.'))]
    return [file for place in places for file in (place.with_suffix('.py'), place / '__init__.py')
            if file.is_file()]


if __name__ == '__main__':
    sys.exit(main())
