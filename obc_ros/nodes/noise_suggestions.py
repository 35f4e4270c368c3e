# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Process noise that estimator_node suggests, from and to messages."""

from collections.abc import Sequence

import numpy as np
from obc_ros.core.estimation.output_feedback import (
    LITTLE,
    recover_sampled_loop,
    Recovery,
)
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import LqrDesign
from obc_ros.nodes.estimator_settings import EstimatorCandidate
from obc_ros.ros.messages import flatten_doubles
from obc_ros.srv import SuggestNoise

MARGINS = ('gain_margin', 'gain_reduction_margin', 'phase_margin', 'disk_margin')


def suggest_noise(request: SuggestNoise.Request, candidate: EstimatorCandidate,
                  design: LqrDesign | None) -> Recovery:
    """
    Return the process noise that recovers the margins of a regulator.

    :param request: gain of the regulator, and the wanted share of its margins.
    :param candidate: the settings in use.
    :param design: the last design of lqr_node, for a request without a gain.
    :raises ObcError: if there is no gain, or one that cannot be used.
    """
    share = request.share or LITTLE
    if not 0.0 < share <= 1.0:
        raise StatementError(f'share = {share:g}: wanted a number above 0 and at most 1, or 0')
    plant, names = candidate.plant, candidate.outputs
    K = _read_gain(request.k, design, *plant.B.shape)
    return recover_sampled_loop(plant.A, plant.B, K, plant.C, plant.Qw, plant.Rv,
                                candidate.design.period, share=share, outputs=names)


def fill_noise(response: SuggestNoise.Response, found: Recovery) -> None:
    """
    Write noise, margins and message into a response.

    :param response: changed in place.
    :param found: what the search found.
    """
    response.success, response.message = found.recovered, _describe(found)
    response.qw, response.added = flatten_doubles(found.Qw), found.q
    loops = found.before.figures, found.loop.figures, found.loop.full_state
    for name in MARGINS:
        setattr(response, name, flatten_doubles([getattr(each, name) for each in loops]))


def _describe(found: Recovery) -> str:
    """Return the margins before and after in words."""
    before, period = found.before.words, found.loop.estimator.period
    if not found.q:
        words = f'the present Qw is the best that was found: {before}'
    else:
        words = (f"with the present Qw {before}; with qw, which adds {found.q:.3g} B B', "
                 f'{found.loop.words}; ros2 param set Qw to qw')
    if not found.recovered:
        words += ('; the wanted share of the margins is not reached: the plant is not of minimum '
                  'phase, has too few outputs, or is measured too seldom')
    return f'{words} (sampled every {period:g} s)'


def _read_gain(k: Sequence[float], design: LqrDesign | None, n: int, m: int) -> Array:
    """Return the gain (m, n) of a request, or of the design."""
    if len(k):
        whose, given = 'k', np.array(k, dtype=float)
    elif design is not None:
        whose, given = 'the gain of lqr_node/design', np.array(design.k, dtype=float)
    else:
        raise StatementError('k is empty, and no lqr_node/design has been received: wanted the '
                             f'gain of the regulator, {m} x {n} numbers row by row')
    if given.size != m * n:
        raise StatementError(f'{whose} has {given.size} numbers: wanted {m} x {n}, row by row')
    return given.reshape(m, n)
