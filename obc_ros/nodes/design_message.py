# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A design as the message LqrDesign."""

from collections.abc import Sequence

import numpy as np
from obc_ros.core.design import Design
from obc_ros.core.design_report import Change, fields
from obc_ros.msg import LqrDesign
from obc_ros.nodes.messages import doubles


def design_message(design: Design, made: Change, error: Sequence[float] | None) -> LqrDesign:
    """Return the message of a design, but for its stamp and revision; see `fields`."""
    return LqrDesign(**{
        name: doubles(value) if isinstance(value, np.ndarray) else value
        for name, value in fields(design, made, error).items()})
