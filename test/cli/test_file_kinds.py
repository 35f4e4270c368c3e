# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Files of another kind than a command takes, and plants of files in `obc lqr` and `obc sweep`."""

import json
from pathlib import Path

from asking import read_json, SCALAR
from obc_ros.cli.obc import main
from obc_ros.core.systems import registry
from obc_ros.core.systems.file_kinds import FileKind, recognise
from obc_ros.core.text.errors import StatementError
import problems
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
# m p'' = F. With Qx = diag(1/2^2, 0) and Qu = 1/4^2: K = [sqrt(q/r), sqrt(2 m K1)] = [2, sqrt(8)].
CART = {
    'states': ['p', 'v'], 'inputs': ['F'], 'parameters': {'m': 2},
    'dynamics': {'p': 'v', 'v': 'F/m'}, 'input_bounds': {'F': [-4, 4]},
    'state_bounds': {'p': [-2, 2]}}
WEIGHTS = {'Qx': [0.25, 0], 'Qu': ['1/16']}
WITHOUT = {key: value for key, value in CART.items() if not key.endswith('bounds')}
GAIN = pytest.approx([2, 8**0.5])
KINDS = {
    FileKind.PROBLEM: SCALAR, FileKind.PLANT: CART,
    FileKind.CASE: {'system': 'aircraft', **WEIGHTS},
    FileKind.PARAMETERS: {'/**/lqr_node': {'ros__parameters': {'system': 'aircraft'}}},
    FileKind.SHEET: {'exercise-2.1-a': 3, 'example-2.4-gain': None},
    FileKind.ANSWER: {'name': 'a', 'status': 'solved', 'certificate': {}, 'lam': []}}


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Enter a folder, and return what writes a file there."""
    monkeypatch.chdir(tmp_path)

    def write_file(name, content):
        (tmp_path / name).write_text(yaml.safe_dump(content, sort_keys=False))
        return name

    return write_file


def test_each_kind_is_recognised():
    for kind, content in KINDS.items():
        assert recognise(content) is kind
        assert recognise({**content, 'name': 'a', 'title': 'b'}) is kind
    assert recognise({**CART, **WEIGHTS}) is FileKind.CASE
    assert recognise({}) is None
    assert recognise({'name': 3, 1: {}}) is None


def test_the_files_of_the_package_are_recognised():
    for path in problems.FOLDER.glob('*.yaml'):
        assert recognise(yaml.safe_load(path.read_text())) is FileKind.PROBLEM
    for path in (ROOT / 'config').glob('*.yaml'):
        assert recognise(yaml.safe_load(path.read_text())) is FileKind.PARAMETERS


@pytest.mark.parametrize('command, taken', [
    ('solve', {FileKind.PROBLEM}), ('lqr', {FileKind.CASE, FileKind.PLANT}),
    ('sweep', {FileKind.PROBLEM, FileKind.CASE, FileKind.PLANT})])
@pytest.mark.parametrize('kind', FileKind)
def test_a_file_of_another_kind_is_named_with_its_command(write, capsys, command, taken, kind):
    if kind in taken:
        return
    file = write('file.yaml', KINDS[kind])
    more = ['--over', 'p=1', '--out', 'out'] if command == 'sweep' else []
    assert main([command, file, *more]) == 2
    told = ''.join(capsys.readouterr())
    what, line = kind.value
    assert f'this is {what}' in told
    assert line.format(file) in told
    assert told.count('\n') == 1
    assert not Path('out').exists()


@pytest.mark.parametrize('kind', [
    kind for kind in FileKind if kind not in (FileKind.PROBLEM, FileKind.PLANT)])
def test_no_other_file_is_a_system(write, kind):
    with pytest.raises(StatementError, match=f'^file.yaml: this is {kind.value[0]}'):
        registry.load_system(write('file.yaml', KINDS[kind]))


def test_the_name_of_an_example_is_not_suggested_to_lqr(capsys):
    assert main(['lqr', 'aircraft_5']) == 2
    told = capsys.readouterr().out
    assert 'did you mean' not in told
    assert told.endswith('; the example of this name is a problem: obc solve aircraft_5\n')
    assert main(['lqr', 'aircraft_6']) == 2
    assert 'aircraft_5' not in capsys.readouterr().out


@pytest.mark.parametrize('case', [
    CART, {**WITHOUT, **WEIGHTS}, {'system': 'cart.yaml', **WEIGHTS}, {'system': 'cart.yaml'},
    {**WITHOUT, 'weights': 'bryson', 'x_max': [2, 1e9], 'u_max': [4]},
    {'system': 'cart.yaml', 'parameters': {'m': '4/2'}, 'setpoint': [1, 0], **WEIGHTS},
    {**CART, 'setpoint': {'p': 0}, 'name': 'cart', 'units': {'p': 'm'}}], ids=str)
def test_the_plant_of_a_regulator_may_stand_in_a_file(write, capsys, case):
    Path('plants').mkdir()
    write('plants/cart.yaml', CART)
    assert main(['lqr', write('plants/case.yaml', case), '--json', 'out']) == 0
    answer = read_json(Path('out') / 'case.json')
    assert answer['K'][0] == GAIN
    has_weights = {'Qx', 'weights'} & set(case)
    assert ("weights by Bryson's rule: Qx: [0.25, 0], Qu: [0.0625]" in answer['message']
            ) == (not has_weights)


@pytest.mark.parametrize('case, words', [
    (WITHOUT, 'Qx: missing; '),
    ({**CART, 'state_bounds': {'p': [0, 2]}}, 'add Qx: [1, 1] and Qu: [1]'),
    ({**CART, 'input_bounds': {'F': [0, None]}}, "Bryson's rule needs bounds"),
    ({**CART, 'Qx': [1]}, 'Qu: missing'), ({**CART, 'A': [[1]]}, "A: the file has 'dynamics'"),
    ({**CART, 'dynamics': {'p': 'v', 'v': 'G'}, **WEIGHTS}, "dynamics.v: unknown name 'G'"),
    ({'system': 'missing.yaml', **WEIGHTS}, 'missing.yaml: cannot be read'),
    ({'system': 'case.yaml', **WEIGHTS}, 'case.yaml: this is a case of a regulator'),
    ({'system': 'cart.yaml', 'parameters': {'k': 1}, **WEIGHTS}, "'k'"),
    ({'system': 'cart.yaml', 'parameters': 3, **WEIGHTS}, 'parameters: wanted a mapping'),
    ({**CART, 'plant': 3, **WEIGHTS}, 'plant: unknown key'),
    ({**CART, 'setpoint': [1], **WEIGHTS}, 'set point of case: wanted 2 numbers')])
def test_a_plant_without_a_regulator_gets_a_sentence(write, capsys, case, words):
    write('cart.yaml', CART)
    file = write('case.yaml', case)
    assert main(['lqr', file]) == 2
    assert words in capsys.readouterr().out
    if words not in ('Qu: missing', 'set point of case: wanted 2 numbers'):   # judged at a point
        assert main(['sweep', file, '--over', 'm=1,2', '--out', 'out']) == 2
        assert not Path('out').exists()


@pytest.mark.slow
@pytest.mark.parametrize('case', [CART, {'system': 'cart.yaml', **WEIGHTS}],
                         ids=['alone', 'named'])
def test_a_sweep_varies_a_plant_of_a_file(write, case):
    xarray = pytest.importorskip('xarray')
    write('cart.yaml', CART)
    assert main(['sweep', write('case.yaml', case), '--over', 'm=1,2,8', '--over', 'plant.m=2',
                 '--out', 'out', '--scheduler', 'none']) == 0
    with xarray.open_dataset('out/sweep.nc') as found:
        gains = found['gain'].values.reshape(3, 2)
        assert json.loads(found.attrs['statement'])['plant']['states'] == ['p', 'v']
    for m, gain in zip((1, 2, 8), gains, strict=True):
        assert gain == pytest.approx([2, (4*m)**0.5])
