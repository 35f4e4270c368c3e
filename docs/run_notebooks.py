# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Run the notebooks, and write them with their results to docs/notebooks (`make docs`)."""

from pathlib import Path
import sys

from nbclient import NotebookClient
import nbformat

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS, PAGES = ROOT / 'notebooks', ROOT / 'docs' / 'notebooks'
LONGEST = 300  # [s] that a cell may take


def run_notebook(path: Path) -> nbformat.NotebookNode:
    """
    Run all cells of a notebook with the kernel of this environment.

    Parameters
    ----------
    path : Path
        The file; it is not changed.

    Returns
    -------
    nbformat.NotebookNode
        With the results of the cells.

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        If a cell raises an exception: a closed form does not hold.

    """
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=LONGEST, kernel_name='python3',
                   resources={'metadata': {'path': str(path.parent)}}).execute()
    return notebook


def main() -> int:
    """Run the notebooks, one after the other."""
    PAGES.mkdir(exist_ok=True)
    for stale in PAGES.glob('*.ipynb'):
        stale.unlink()
    for path in sorted(NOTEBOOKS.glob('*.ipynb')):
        print(f'obc_ros: {path.name}', flush=True)
        nbformat.write(run_notebook(path), PAGES / path.name)
    return 0


if __name__ == '__main__':
    sys.exit(main())
