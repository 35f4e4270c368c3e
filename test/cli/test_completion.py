# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The scripts of `obc completion`, and what they complete in bash."""

import shutil
import subprocess
import sys

from obc_ros.cli.completion import SHELLS
from obc_ros.cli.obc import find_subcommands, main
import pytest


@pytest.fixture(scope='module')
def scripts(tmp_path_factory):
    """Return the completion script of each shell."""
    folder = tmp_path_factory.mktemp('completion')
    for shell in SHELLS:
        with (folder / shell).open('w') as script:
            subprocess.run([sys.executable, '-m', 'obc_ros.cli.obc', 'completion', shell],
                           stdout=script, check=True)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize('shell', SHELLS)
def test_a_completion_script_knows_commands_and_methods(scripts, shell):
    text = (scripts / shell).read_text()
    for word in ('sweep', 'time-limit', 'time_optimal', 'completion', '.yaml'):
        assert word in text
    if shutil.which(shell):   # zsh and fish may be missing
        assert subprocess.run([shell, '-n', scripts / shell], check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize('words, found', [
    (['so'], {'solve'}), (['solve', '--tim'], {'--time-limit'}),
    (['solve', 'en'], {'energy.yaml'}), (['solve', 'zermelo_s'], {'zermelo_shear'}),
    (['examples', 'did'], {'dido'}), (['solve', '--json', 'pla'], {'place'}),
    (['solve', '--method', 'ric'], {'riccati'}), (['bench', 'startu'], {'startup'}),
    (['completion', 'f'], {'fish'}), (['lqr', 'chains.yaml', '--fu'], {'--full'})], ids=str)
def test_bash_completes(tmp_path, monkeypatch, scripts, words, found):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'place').mkdir()
    for name in ('energy.yaml', 'chains.yaml', 'ears.txt'):
        (tmp_path / name).write_text('')
    program = ('source "$1"; shift; COMP_WORDS=(obc "$@"); COMP_CWORD=$#; '
               '_shtab_obc obc "${@: -1}" "${COMP_WORDS[COMP_CWORD - 1]}"; '
               'printf "%s\\n" "${COMPREPLY[@]}"')
    done = subprocess.run(['bash', '--norc', '-c', program, 'bash', scripts / 'bash', *words],
                          capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == found
    assert done.stderr == ''


@pytest.mark.slow
def test_names_of_the_gallery_are_completed(scripts):
    assert 'gallery' in find_subcommands()
    for shell in SHELLS:
        assert 'exercise-2.10' in (scripts / shell).read_text()


def test_an_unknown_shell_is_refused(capsys):
    with pytest.raises(SystemExit) as exit_:
        main(['completion', 'fisch'])
    assert exit_.value.code == 2
    assert "no 'fisch' (did you mean 'fish'?)" in capsys.readouterr().err
