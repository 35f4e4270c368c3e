# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of weight suggestions from and to messages."""

from obc_ros.core.lqr.design.design import LinearizedPlant
from obc_ros.core.lqr.weight_search import StepSpecifications, suggest, Suggestion
from obc_ros.ros.messages import flatten_doubles
from obc_ros.srv import SuggestWeights


def suggest_weights(request: SuggestWeights.Request, plant: LinearizedPlant) -> Suggestion:
    """
    Return the weights nearest to the specifications of a request.

    :param request: the specifications.
    :param plant: the plant of the node.
    :raises ObcError: if a specification cannot be used, or no weights stabilise the plant.
    """
    return suggest(
        plant.A, plant.B,
        StepSpecifications(request.rise_time, request.overshoot, tuple(request.peak_input)),
        x_max=tuple(request.x_max), u_max=tuple(request.u_max), inputs=plant.system.input_names)


def fill_suggestion(response: SuggestWeights.Response, found: Suggestion) -> None:
    """
    Write weights, message and trade-off table into a response, without the design.

    :param response: changed in place.
    :param found: what the search found.
    """
    response.success, response.message = found.success, found.message
    response.qx = flatten_doubles(found.best.weights.Qx)
    response.qu = flatten_doubles(found.best.weights.Qu)
    response.table_scale = flatten_doubles([each.scale for each in found.table])
    response.table_rise_time = flatten_doubles([each.rise_time for each in found.table])
    response.table_overshoot = flatten_doubles([each.overshoot for each in found.table])
    response.table_peak_input = flatten_doubles([each.peak_input for each in found.table])
