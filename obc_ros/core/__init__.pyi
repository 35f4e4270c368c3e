# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
from obc_ros.core.library.answer import Answer as Answer
from obc_ros.core.library.problem import Problem as Problem
from obc_ros.core.library.solving import certify as certify
from obc_ros.core.library.solving import solve as solve
from obc_ros.core.text.errors import ObcError as ObcError
