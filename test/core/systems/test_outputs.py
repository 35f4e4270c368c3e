# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Outputs of systems: what sensors measure."""

import math

import numpy as np
from obc_ros.core.systems.file import build_system
from obc_ros.core.systems.registry import get_system
from obc_ros.core.text.errors import StatementError
import pytest

STATED = {'states': ['q', 'a'], 'inputs': ['u'], 'parameters': {'l': 2},
          'dynamics': {'q': 'a', 'a': 'u'}, 'angles': ['a'], 'units': {'a': 'rad', 'tip': 'm'}}


def test_outputs_are_expressions_of_states_inputs_and_parameters():
    system = build_system({**STATED, 'outputs': {'tip': 'q + l * sin(a)', 'turn': 'a', 'q': 'q'}})
    assert system.output_names == ('tip', 'turn', 'q')
    assert [(each.unit, each.angle) for each in system.outputs] == [
        ('m', False), ('rad', True), ('', False)]
    y, C = system.measure(np.array([1.0, 0.5]), np.zeros(1))
    assert y == pytest.approx([1 + 2 * math.sin(0.5), 0.5, 1.0])
    assert pytest.approx(np.array([[1, 2 * math.cos(0.5)], [0, 1], [1, 0]])) == C
    y, _ = system.with_parameters({'l': 3.0}).measure(np.array([1.0, 0.5]), np.zeros(1))
    assert y[0] == pytest.approx(1 + 3 * math.sin(0.5))


def test_without_outputs_all_states_are_measured():
    system = build_system({**STATED, 'units': {}})
    assert system.outputs == system.states
    y, C = system.measure(np.array([1.0, 0.5]), np.zeros(1))
    assert y.tolist() == [1.0, 0.5] and (np.eye(2) == C).all()


@pytest.mark.parametrize('outputs', [
    {'tip': 'q +'}, {'tip': 'b'}, {'tip': '__import__("os")'}, {'tip': 'q.real'}, {'q': 'a'},
    {'u': 'u'}, {'l': 'q'}, {'sin': 'q'}, {'1a': 'q'}, {'tip': None}, {'tip': [1]}, ['q'], 'q',
    7, {'tip': 'q ** ' * 200 + 'q'}, {'x' * 65: 'q'}])
def test_bad_outputs_are_refused(outputs):
    with pytest.raises(StatementError, match='outputs'):
        build_system({**STATED, 'outputs': outputs})


@pytest.mark.parametrize(('name', 'outputs'), [
    ('aircraft', ('gps_x', 'gps_y', 'attitude', 'gyro')),
    ('vehicle', ('gps_x', 'gps_y', 'compass'))])
def test_outputs_of_registered_systems(name, outputs):
    system = get_system(name)
    assert system.output_names == outputs
    assert system.outputs[2].angle and system.outputs[2].unit == 'rad'
