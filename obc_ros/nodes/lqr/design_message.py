# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A design as the message LqrDesign, and the request for weights that make one."""

from collections.abc import Sequence

from obc_ros.core.lqr.design.design import Design, LinearizedPlant
from obc_ros.core.lqr.design.report import Change, report_fields
from obc_ros.core.lqr.weight_search import suggest, Suggestion, Wishes
from obc_ros.msg import LqrDesign
from obc_ros.ros.messages import build_lqr_design, flatten_doubles
from obc_ros.srv import SuggestWeights


def design_message(design: Design, made: Change, error: Sequence[float] | None, note: str = ''
                   ) -> LqrDesign:
    """Return the message of a design, but for its stamp and revision; see `report_fields`."""
    message = build_lqr_design(report_fields(design, made, error))
    if note:
        message.sentence += f'; {note}'
    return message


def suggest_weights(request: SuggestWeights.Request, plant: LinearizedPlant) -> Suggestion:
    """
    Return the weights nearest to the wishes of a request.

    Raises
    ------
    ObcError
        If a wish cannot be used, or no weights stabilise the plant.

    """
    return suggest(
        plant.A, plant.B,
        Wishes(request.rise_time, request.overshoot, tuple(request.peak_input)),
        x_max=tuple(request.x_max), u_max=tuple(request.u_max), inputs=plant.system.input_names)


def fill_suggestion(response: SuggestWeights.Response, found: Suggestion) -> None:
    """Put weights, words and the trade-off table into a response; not the design."""
    response.success, response.message = found.success, found.message
    response.qx = flatten_doubles(found.best.weights.Qx)
    response.qu = flatten_doubles(found.best.weights.Qu)
    response.table_scale = flatten_doubles([each.scale for each in found.table])
    response.table_rise_time = flatten_doubles([each.rise_time for each in found.table])
    response.table_overshoot = flatten_doubles([each.overshoot for each in found.table])
    response.table_peak_input = flatten_doubles([each.peak_input for each in found.table])
