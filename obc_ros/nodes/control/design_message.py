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

    Parameters
    ----------
    design : Design
        The design.
    made : Change
        The change from the previous design.
    error : sequence of float or None
        Current x - xe (n,).
    note : str
        Text to append to the sentence.
    period : float
        Measured period of the commands [s]; 0: not known.

    Returns
    -------
    LqrDesign

    """
    message = build_lqr_design(report_fields(design, made, error, period))
    if note:
        message.sentence += f'; {note}'
    return message
