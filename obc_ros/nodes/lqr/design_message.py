# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of designs and weight suggestions to messages."""

from collections.abc import Sequence

from obc_ros.core.lqr.design.design import Design, LinearizedPlant
from obc_ros.core.lqr.design.report import Change, report_fields
from obc_ros.core.lqr.weight_search import StepSpecifications, suggest, Suggestion
from obc_ros.msg import LqrDesign
from obc_ros.ros.messages import build_lqr_design, flatten_doubles
from obc_ros.srv import SuggestWeights


def design_message(design: Design, made: Change, error: Sequence[float] | None, note: str = ''
                   ) -> LqrDesign:
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

    Returns
    -------
    LqrDesign

    """
    message = build_lqr_design(report_fields(design, made, error))
    if note:
        message.sentence += f'; {note}'
    return message


def suggest_weights(request: SuggestWeights.Request, plant: LinearizedPlant) -> Suggestion:
    """
    Return the weights nearest to the specifications of a request.

    Parameters
    ----------
    request : SuggestWeights.Request
        The specifications.
    plant : LinearizedPlant
        The plant of the node.

    Returns
    -------
    Suggestion

    Raises
    ------
    ObcError
        If a specification cannot be used, or no weights stabilise the plant.

    """
    return suggest(
        plant.A, plant.B,
        StepSpecifications(request.rise_time, request.overshoot, tuple(request.peak_input)),
        x_max=tuple(request.x_max), u_max=tuple(request.u_max), inputs=plant.system.input_names)


def fill_suggestion(response: SuggestWeights.Response, found: Suggestion) -> None:
    """
    Write weights, message and trade-off table into a response, without the design.

    Parameters
    ----------
    response : SuggestWeights.Response
        Changed in place.
    found : Suggestion
        What the search found.

    """
    response.success, response.message = found.success, found.message
    response.qx = flatten_doubles(found.best.weights.Qx)
    response.qu = flatten_doubles(found.best.weights.Qu)
    response.table_scale = flatten_doubles([each.scale for each in found.table])
    response.table_rise_time = flatten_doubles([each.rise_time for each in found.table])
    response.table_overshoot = flatten_doubles([each.overshoot for each in found.table])
    response.table_peak_input = flatten_doubles([each.peak_input for each in found.table])
