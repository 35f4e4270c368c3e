# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The files for RViz and Foxglove name topics and fields that the nodes have."""

import json
from pathlib import Path
import re

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path as PathMessage
from obc_ros.core.systems import registry
from obc_ros.msg import Command, LqrDesign, State
import pytest
from visualization_msgs.msg import MarkerArray
import yaml

ROOT = Path(__file__).resolve().parents[3]
RVIZ = yaml.safe_load((ROOT / 'rviz' / 'obc.rviz').read_text(encoding='utf-8'))
FOXGLOVE = json.loads((ROOT / 'foxglove' / 'obc.json').read_text(encoding='utf-8'))
PANELS = FOXGLOVE['configById']
DISPLAYS = {'rviz_default_plugins/MarkerArray': MarkerArray,
            'rviz_default_plugins/Path': PathMessage}
# Of the RViz and the Foxglove that their repositories publish.
RVIZ_CLASSES = {
    *(f'rviz_default_plugins/{name}' for name in (
        'Grid', 'MarkerArray', 'Path', 'TF', 'MoveCamera', 'Select', 'FocusCamera', 'Measure',
        'Orbit', 'TopDownOrtho')),
    *(f'rviz_common/{name}' for name in ('Displays', 'Views', 'Time'))}
KEYS = {
    '3D': {'cameraState', 'followMode', 'followTf', 'scene', 'transforms', 'topics', 'layers'},
    'Plot': {'title', 'paths', 'xAxisVal', 'showLegend', 'legendDisplay', 'showPlotValuesInLegend',
             'showXAxisLabels', 'showYAxisLabels', 'isSynced', 'followingViewWidth',
             'sidebarDimension'},
    'RosOut': {'searchTerms', 'minLogLevel'}, 'Parameters': {'title'},
    'Tab': {'activeTabIdx', 'tabs'}}
TYPES = {'/markers': MarkerArray, '/plan_markers': MarkerArray, '/trail': PathMessage,
         '/plan': PathMessage, '/state': State, '/command': Command,
         '/lqr_node/design': LqrDesign, '/diagnostics': DiagnosticArray}


def name(message_type):
    """Return the name of a type as the graph has it."""
    return f'{message_type.__module__.split(".")[0]}/msg/{message_type.__name__}'


def list_displays():
    """Return topic, type and QoS of each display of RViz that has a topic."""
    return [(each['Topic']['Value'], DISPLAYS[each['Class']], each['Topic'])
            for each in RVIZ['Visualization Manager']['Displays'] if 'Topic' in each]


def list_panels(layout):
    """Return the panels of a layout of Foxglove, those of tabs included."""
    if isinstance(layout, dict):
        return [*list_panels(layout['first']), *list_panels(layout['second'])]
    tabs = PANELS[layout].get('tabs', ())
    return [layout, *(panel for tab in tabs for panel in list_panels(tab['layout']))]


def list_plots():
    """Return the message paths of all plots, with the tab in which they are."""
    return [(tab['title'].lower(), path['value']) for tab in PANELS['Tab!obc']['tabs']
            for panel in list_panels(tab['layout']) if panel.startswith('Plot!')
            for path in PANELS[panel]['paths']]


def test_the_nodes_offer_the_topics_of_the_files(spawn, probe):
    """Their types and qualities of service are those that the files want."""
    for node in ('plant_simulator', 'lqr_node', 'trajectory_server'):
        spawn(node)
    wanted = {f'/{topic}': message_type for topic, message_type, _ in list_displays()}
    wanted |= {topic: TYPES[topic] for each, panel in PANELS.items() if each.startswith('3D!')
               for topic in panel['topics']}
    wanted |= {topic: TYPES[topic] for topic in (
        re.match(r'/[a-z_/]+', path)[0] for _, path in list_plots())}
    assert wanted.items() <= TYPES.items() and len(wanted) == len(TYPES)
    probe.wait_for(lambda: all([name(each)] == dict(
        probe.node.get_topic_names_and_types()).get(topic) for topic, each in wanted.items()))
    for topic, _, profile in list_displays():
        for each in probe.node.get_publishers_info_by_topic(f'/{topic}'):
            durability = each.qos_profile.durability.name.replace('_', ' ').title()
            assert profile['Durability Policy'] == durability, topic


def test_rviz_shows_each_view_in_the_frame_of_the_nodes():
    assert {topic for topic, *_ in list_displays()} == {'markers', 'plan_markers', 'plan', 'trail'}
    assert RVIZ['Visualization Manager']['Global Options']['Fixed Frame'] == 'odom'


def list_classes(entry):
    """Return the names of all classes in the file for RViz, with their place."""
    if isinstance(entry, list):
        return [name for each in entry for name in list_classes(each)]
    if not isinstance(entry, dict):
        return []
    return [*([entry['Class']] if entry.get('Class') else []),
            *(name for each in entry.values() for name in list_classes(each))]


def test_rviz_has_the_classes_of_the_file():
    found = list_classes(RVIZ)
    assert set(found) == RVIZ_CLASSES
    assert len(found) > len(RVIZ_CLASSES)   # some are shown more than once


def test_the_layout_has_all_its_panels_once():
    panels = list_panels(FOXGLOVE['layout'])
    assert sorted(panels) == sorted(PANELS)
    assert {each.partition('!')[0] for each in panels} == set(KEYS)
    for panel, settings in PANELS.items():
        assert set(settings) <= KEYS[panel.partition('!')[0]], panel


@pytest.mark.parametrize(('system', 'path'), list_plots())
def test_a_plot_names_fields_that_exist(system, path):
    topic, field = re.match(r'(/[a-z_/]+)\.(\w+)', path).groups()
    fields = TYPES[topic].get_fields_and_field_types()
    assert field in fields
    if found := re.fullmatch(r'/(state|command)\.[xu]\[(\d+)\]', path):
        plant = registry.get_system(system)
        assert int(found[2]) < (plant.n if found[1] == 'state' else plant.m)


@pytest.mark.parametrize('system', ['aircraft', 'vehicle'])
def test_every_state_and_input_has_a_plot(system):
    plant = registry.get_system(system)
    labels = [path['label'] for tab in PANELS['Tab!obc']['tabs'] if tab['title'].lower() == system
              for panel in list_panels(tab['layout']) if panel.startswith('Plot!')
              for path in PANELS[panel]['paths'] if path['value'].startswith(('/state', '/comm'))]
    assert labels == [f'{each.name} [{each.unit}]' for each in (*plant.states, *plant.inputs)]


def test_the_plotted_value_of_the_diagnostics_exists(spawn, probe):
    """Foxglove selects an entry of a list by a field in braces."""
    spawn('lqr_node')
    arrays = probe.listen(DiagnosticArray, '/diagnostics')
    [path] = {path for _, path in list_plots() if path.startswith('/diagnostics')}
    status, key = re.fullmatch(
        r'/diagnostics\.status\[:\]\{name=="(.*)"\}\.values\[:\]\{key=="(.*)"\}\.value',
        path).groups()
    probe.wait_for(lambda: arrays, what='diagnostics')
    assert [value.key for each in arrays[0].status if each.name == status
            for value in each.values if value.key == key] == [key]
