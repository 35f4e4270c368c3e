# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A plugin of pytest for `provenance`: changes the default of one option.

``pytest -p _changed_option`` reads NAME=VALUE from the variable OBC_ROS_OPTION.
"""

import os

from obc_ros.core.solver.options import DEFAULTS, read_options

_name = os.environ['OBC_ROS_OPTION'].partition('=')[0]
_group, _key = _name.split('.')
# The default groups are shared by all that uses the defaults; they are frozen for all others.
object.__setattr__(getattr(DEFAULTS, _group), _key, getattr(
    getattr(read_options([os.environ['OBC_ROS_OPTION']]), _group), _key))
