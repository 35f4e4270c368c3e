# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of estimator_node: the estimate, the diagnostics, and suggested process noise."""

from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from obc_ros.core.estimation import delayed_filter
from obc_ros.core.estimation.delayed_filter import DelayedFilter
from obc_ros.core.estimation.output_feedback import (
    LITTLE,
    recover_sampled_loop,
    Recovery,
)
from obc_ros.core.numerics.arrays import Array
from obc_ros.core.systems.system import System
from obc_ros.core.text.errors import StatementError
from obc_ros.msg import Estimate, LqrDesign, State
from obc_ros.nodes.estimator_settings import EstimatorCandidate
from obc_ros.ros.diagnostics import make_status
from obc_ros.ros.messages import flatten_doubles, set_stamp
from obc_ros.srv import SuggestNoise

COUNTS = ('used', 'late', 'out of order', 'too late', 'repeated', 'missing', 'not used',
          'not finite', 'out of range', 'malformed', 'outliers', 'restarts', 'faults', 'future')
UNUSABLE = ('not finite', 'out of range')   # entries that are no measurements
DROPPED = (*UNUSABLE, 'malformed', 'future')
MARGINS = ('gain_margin', 'gain_reduction_margin', 'phase_margin', 'disk_margin')


class EstimateMessages:
    """The messages of an estimate, which are changed in place and share the header."""

    def __init__(self, system: System) -> None:
        self.state, self.estimate = State(names=list(system.state_names)), Estimate()
        self.estimate.header = self.state.header
        self._names: tuple[str, ...] = ()

    def fill_state(self, mean: delayed_filter.Estimate, restarts: int, frame: str) -> None:
        """Write a mean, the number of restarts, and the frame_id into `state`."""
        set_stamp(self.state.header.stamp, mean.stamp)
        self.state.header.frame_id = frame
        # Arrays are taken as they are; the setters check other sequences entry by entry.
        self.state.x = array('d', mean.x.tobytes())
        self.state.restarts = restarts

    def fill_estimate(self, mean: delayed_filter.Estimate, delayed: DelayedFilter) -> None:
        """Write what `state` does not contain into `estimate`, after `fill_state`."""
        message, consistency = self.estimate, delayed.consistency
        message.x, message.covariance = self.state.x, array('d', mean.P.tobytes())
        message.restarts = self.state.restarts
        message.consistency = consistency.ratio
        message.band[:] = consistency.lower, consistency.upper
        message.age = 1e-9 * (mean.stamp - (delayed.newest or mean.stamp))
        if delayed.last is not None:
            names, update = delayed.last
            if names != self._names:
                self._names, message.names = names, list(names)
            message.nis = update.nis
            message.innovation = array('d', update.normalized.tobytes())


@dataclass(frozen=True)
class Traffic:
    """
    What the node has received and published.

    :ivar received, published: number of measurements and of estimates.
    :ivar counts: of the filter.
    :ivar silence: local time since the last measurement arrived [s].
    :ivar ahead: its stamp minus the local time then [s].
    :ivar age: of the newest measurement in use [s]; None: there is none.
    """

    received: int = 0
    published: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    silence: float = 0.0
    ahead: float = 0.0
    age: float | None = None


def estimator_status(name: str, candidate: EstimatorCandidate, delayed: DelayedFilter,
                     now: Traffic, before: Traffic) -> DiagnosticStatus:
    """Return the diagnostics of the estimator, by the traffic now and at the last ones."""
    consistency = delayed.consistency
    level, words = _explain_silence(candidate, now, before) or _judge(
        candidate, delayed, now.counts - before.counts)
    return make_status(f'{name}: estimate', level, words, {
        'age of the newest measurement [s]': '' if now.age is None else f'{now.age:.3f}',
        'stamp minus local time [s]': f'{now.ahead:.3f}' if now.received else '',
        'estimates published': now.published,
        'consistency': f'{consistency.ratio:.3f}',
        'band': f'{consistency.lower:.3f} to {consistency.upper:.3f}',
        'design': candidate,
        **{f'measurements {what}': now.counts[what] for what in COUNTS}})


def _explain_silence(candidate: EstimatorCandidate, now: Traffic, before: Traffic
                     ) -> tuple[bytes, str] | None:
    settings = candidate.settings
    if not now.received:
        return DiagnosticStatus.WARN, 'no measurement yet'
    is_regular = now.age is not None and 0.0 <= now.age <= settings.measurement_timeout
    if is_regular and now.published > before.published:
        return None
    fail = partial('{}: no estimate is published'.format)
    if now.received == before.received:
        if now.silence < 0.0:
            return DiagnosticStatus.ERROR, fail(
                f'the local time went back to {-now.silence:.3g} s before the last measurement')
        if now.silence > settings.measurement_timeout:
            return DiagnosticStatus.ERROR, fail(f'no measurement for {now.silence:.2f} s')
        return DiagnosticStatus.WARN, 'no new estimate'
    allowed = settings.stamp_timeout if now.ahead > 0.0 else settings.measurement_timeout
    if settings.stamp_timeout and abs(now.ahead) > allowed:
        return DiagnosticStatus.ERROR, fail(
            f'measurements arrive with stamps {abs(now.ahead):.3g} s '
            f'{"after" if now.ahead > 0.0 else "before"} the local time') + (
            '; synchronise the clocks, or set stamp_timeout to 0')
    grown = now.counts - before.counts
    reasons = ', '.join(f'{grown[kind]} {kind}' for kind in COUNTS
                        if grown[kind] and kind not in ('used', 'late', 'missing'))
    return DiagnosticStatus.ERROR, fail(
        'measurements arrive, but none is in use' + f' ({reasons})' * bool(reasons))


def _judge(candidate: EstimatorCandidate, delayed: DelayedFilter, grown: Counter[str]
           ) -> tuple[bytes, str]:
    """Return level and words while estimates are published."""
    consistency = delayed.consistency
    unseen = [each for each in candidate.outputs if each not in delayed.measured]
    dropped = ', '.join(f'{grown[kind]} {kind}' for kind in DROPPED if grown[kind])
    for words in (
            f'the filter was restarted: {delayed.reason}' * bool(grown['restarts']),
            f'not measured: {", ".join(unseen)}' * bool(unseen),
            f'measurements or commands were dropped: {dropped}' * bool(dropped),
            str(consistency) * (consistency.ratio > consistency.upper)):
        if words:
            return DiagnosticStatus.WARN, words
    return DiagnosticStatus.OK, str(consistency)


def suggest_noise(request: SuggestNoise.Request, candidate: EstimatorCandidate,
                  design: LqrDesign | None) -> Recovery:
    """Return the noise that recovers the margins of a gain: of the request, else the design."""
    share = request.share or LITTLE
    if not 0.0 < share <= 1.0:
        raise StatementError(f'share = {share:g}: wanted a number above 0 and at most 1, or 0')
    plant, names = candidate.plant, candidate.outputs
    K = _read_gain(request.k, design, *plant.B.shape)
    return recover_sampled_loop(plant.A, plant.B, K, plant.C, plant.Qw, plant.Rv,
                                candidate.design.period, share=share, outputs=names)


def fill_noise(response: SuggestNoise.Response, found: Recovery) -> None:
    """Write noise, margins and message into a response."""
    response.success, response.message = found.recovered, _describe(found)
    response.qw, response.added = flatten_doubles(found.Qw), found.q
    loops = found.before.figures, found.loop.figures, found.loop.full_state
    for name in MARGINS:
        setattr(response, name, flatten_doubles([getattr(each, name) for each in loops]))


def _describe(found: Recovery) -> str:
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
