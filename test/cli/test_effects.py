# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arguments of `obc` that would have no effect: each is refused, in every subcommand."""

from obc_ros.cli.obc import build_parser, find_subcommands, main, NEED_ROS
from obc_ros.cli.terminal import name_argument, Parser
from obc_ros.ros.installation import explain_missing_ros
import pytest

COMPATIBLE = 'accepted as by `ros2`'   # begins the help of options that only `ros2` needs
# Options that have an effect whatever else is given. A new one is put here, or gets a `limit`.
# Verbs of `ros2` take what `ros2` takes, such as a rate of one message.
ALWAYS = {
    'demo': '--out --format --real-time',
    'solve': '--json --plot --server --time-limit --method --accept --option '
             '--list-options --trace',
    'lqr': '--json --plot --server --full',
    'sweep': '--over --sample --out --plot --resume --scheduler --workers --chunk --time-limit '
             '--method --option',
    'gallery': '--list --sheet --check --slides',
    'examples': '--match --copy',
    'view': '--host --port --namespace --no-browser',
    'bench': '--list',
    'completion': '',
    'param list': '--filter --param-prefixes --param-type --timeout --include-hidden-nodes '
                  '--spin-time',
    'param get': '--hide-type --timeout', 'param set': '--timeout',
    'param describe': '--timeout', 'param dump': '--timeout',
    'param load': '--no-use-wildcard --timeout',
    'service call': '--stdin --timeout',
    'service list': '--show-types --count-services --include-hidden-services --spin-time',
    'topic list': '--show-types --count-topics --include-hidden-topics --spin-time',
    'topic info': '--verbose --spin-time',
    'topic echo': '--once --timeout --field --full-length --truncate-length --no-arr --no-str '
                  '--qos-depth --qos-reliability --qos-durability',
    'topic hz': '--window',
    'topic pub': '--stdin --once --times --rate --wait-matching-subscriptions '
                 '--max-wait-time-secs --keep-alive --qos-depth --qos-reliability '
                 '--qos-durability',
    'action send_goal': '--stdin --feedback --timeout',
    'interface show': '--all-comments --no-comments',
    'lifecycle get': '--timeout --include-hidden-nodes --spin-time', 'lifecycle set': '--timeout',
    'node list': '--all --count-nodes --spin-time',
    'run': '', 'launch': '--show-args',
}


def find_parsers(parser, words=()):
    """Return the parsers that have no subcommands, by their words."""
    inner = [action for action in parser._actions if action.nargs == 'A...' and action.choices]
    if not inner:
        return {' '.join(words): parser}
    return {name: found for action in inner for word, each in action.choices.items()
            for name, found in find_parsers(each, (*words, word)).items()}


@pytest.fixture(scope='module')
def parsers():
    """Return the parsers of all commands that this machine has."""
    pure = bool(explain_missing_ros())
    return find_parsers(build_parser([
        name for name in find_subcommands() if not (pure and name in NEED_ROS)]))


def test_each_option_has_an_effect_or_a_limit(parsers):
    for command, parser in parsers.items():
        name = command.split()[0]
        if name in NEED_ROS and (explain_missing_ros() or command not in ALWAYS):
            continue   # without ROS 2 it has no arguments
        options = {name_argument(action) for action in parser._actions if action.option_strings
                   and action.dest != 'help' and COMPATIBLE not in (action.help or '')}
        always = set(ALWAYS[command].split())
        assert options == always | {name for name in parser.effects if name[0] == '-'}, command
        assert not always & set(parser.effects), command


LINES = [
    ('solve a.yaml --format pdf', '--format', 'without --plot'),
    ('lqr a.yaml --format pdf', '--format', 'without --plot'),
    ('sweep a.yaml --out a --over p=1 --format pdf', '--format', 'without --plot'),
    ('sweep a.yaml --out a --over p=1 --seed 1', '--seed', 'without --sample'),
    ('sweep a.yaml --out a --over p=1 --count 3', '--count', 'without --sample'),
    ('examples dido --copy a --long', '--long', 'with NAME'),
    ('examples --copy a --long', '--long', 'with --copy'),
    ('examples dido --long', '--long', 'with NAME'),
    ('examples --copy a --list', '--list', 'with --copy'),
    ('bench lqr --list', 'NAME', 'with --list'),
    ('bench --peers --list', '--peers', 'with --list'),
]
WITH_ROS = [
    ('view a.mcap --scenario vehicle', '--scenario', 'with FILE'),
    ('view a.mcap --priority 0', '--priority', 'with FILE'),
    ('view a.mcap --namespace / --control', '--control', 'with FILE'),
    ('view a.mcap --control', '--control', 'without --namespace'),
    ('view --control', '--control', 'without --namespace'),
    ('view --namespace / --scenario vehicle', '--scenario', 'with --namespace'),
    ('view --namespace / --priority 0', '--priority', 'with --namespace'),
]


@pytest.mark.parametrize('line, name, why', [
    *LINES, *(pytest.param(*each, marks=pytest.mark.ros) for each in WITH_ROS)])
def test_an_argument_without_an_effect_is_refused(tmp_path, monkeypatch, capsys, line, name, why):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as exit_:
        main(line.split())
    assert exit_.value.code == 2
    assert capsys.readouterr().err.endswith(f'error: {name} has no effect {why}\n')
    assert not list(tmp_path.iterdir())


def test_arguments_that_are_only_defaults_are_not_refused():
    parser = Parser()
    parser.add_argument('names', nargs='*', metavar='NAME')
    parser.add_argument('--format', default='png')
    parser.add_argument('--plot')
    parser.limit('--format', needs=['--plot'])
    parser.limit('NAME', without=['--plot'])
    assert parser.parse_args(['--plot', 'a']).format == 'png'
    assert parser.parse_args(['b', 'c']).names == ['b', 'c']
    assert parser.parse_args(['--form=pdf', '--plot', 'a']).format == 'pdf'


@pytest.mark.parametrize('more, words', [
    (['--method', 'riccati'], 'method: has no effect on a regulator'),
    (['--option', 'multistart.most=2'], 'options: has no effect on a regulator'),
    (['--scheduler', 'tcp://127.0.0.1:1', '--workers', '2'],
     'workers 2: has no effect with a scheduler')])
def test_a_sweep_refuses_what_its_problem_or_workers_ignore(tmp_path, capsys, more, words):
    (tmp_path / 'case.yaml').write_text('{A: [[0]], B: [[1]], Qx: [1], Qu: [1]}')
    out = tmp_path / 'out'
    assert main(['sweep', str(tmp_path / 'case.yaml'), '--over', 'Qx.0=1,2', '--out', str(out),
                 *more]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()
