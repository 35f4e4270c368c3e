# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of a design to its message."""

from collections.abc import Sequence

from obc_ros.core.lqr.design.design import Design
from obc_ros.core.lqr.design.report import Change, report_fields
from obc_ros.msg import LqrDesign
from obc_ros.ros.messages import build_lqr_design


def design_message(design: Design, made: Change, error: Sequence[float] | None, note: str = '',
                   period: float = 0.0) -> LqrDesign:
    """
    Return the message of a design, without stamp and revision.

    :param made: the change from the previous design.
    :param error: current x - xe (n,).
    :param note: text to append to the sentence.
    :param period: measured period of the commands [s]; 0: not known.
    """
    message = build_lqr_design(report_fields(design, made, error, period))
    if note:
        message.sentence += f'; {note}'
    return message
