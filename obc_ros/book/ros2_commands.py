# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests, parameters and messages as `ros2` commands."""

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml


def write_service_call(name: str, kind: Any, request: Any, node: str = 'trajectory_server'
                       ) -> str:
    """Return the command that sends a request to a node."""
    text = _quoted(_flow(drop_defaults(request)))
    return f'ros2 service call /{node}/{name} obc_ros/srv/{kind.__name__} {text}'


def run_node(node: str, parameters: Mapping[str, Any], renamed: Mapping[str, str] | None = None
             ) -> str:
    """Return the command that starts a node, with other names for topics."""
    given = ' '.join([*(f'-p {_argument(name, value)}' for name, value in parameters.items()),
                      *(f'-r {topic}:={name}' for topic, name in (renamed or {}).items())])
    return f'ros2 run obc_ros {node} --ros-args {given}'


def publish(topic: str, message: Any, file: Path) -> str:
    """
    Write a message to a file, and return the command that publishes it.

    The stamp is left out: it belongs to this run. The path is relative to the folder of the page.
    """
    fields = {name: value for name, value in drop_defaults(message).items() if name != 'header'}
    for name, value in fields.items():
        if not isinstance(value, str):
            fields[name] = np.round(value, 9).tolist()
    file.write_text(_flow(fields) + '\n', encoding='utf-8')
    kind = type(message)
    place = Path(*file.parts[-3:])
    return (f'ros2 topic pub --once --keep-alive 2 --qos-durability transient_local /{topic} '
            f'obc_ros/msg/{kind.__name__} "$(cat {place})"')


def set_parameter(node: str, name: str, value: Any) -> str:
    """Return the command that sets a parameter."""
    return f'ros2 param set /{node} {name} {_quoted(_flow(_value(value)))}'


def write_argument(name: str, value: Any) -> str:
    """Return ``name:=value`` as an argument of a node."""
    return f'{name}:={_flow(_value(value))}'


def drop_defaults(message: Any) -> Any:
    """Return a message as plain values for YAML, without fields at their defaults."""
    if hasattr(message, 'get_fields_and_field_types'):
        fields = {name: drop_defaults(getattr(message, name))
                  for name in message.get_fields_and_field_types()}
        return {name: value for name, value in fields.items()
                if value not in ('', [], {}, 0.0, False)}
    if isinstance(message, (array, list)):
        return [drop_defaults(each) for each in message]
    return message


def _argument(name: str, value: Any) -> str:
    text = write_argument(name, value)
    return _quoted(text) if ' ' in text or '[' in text else text


def _value(value: Any) -> Any:
    if isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, list) and value and isinstance(value[0], str):
        return value
    numbers = np.asarray(value, dtype=float)
    return numbers.ravel().tolist() if numbers.ndim else float(numbers)


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10**9, sort_keys=False)
    return text.removesuffix('\n').removesuffix('\n...').strip()


def _quoted(text: str) -> str:
    for character in '\\"$`':
        text = text.replace(character, f'\\{character}')
    return f'"{text}"'
