# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of estimator_node: the estimate with its covariance, and the diagnostics."""

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from obc_ros.core.estimation import delayed_filter
from obc_ros.core.estimation.delayed_filter import DelayedFilter
from obc_ros.msg import Estimate
from obc_ros.nodes.estimator_settings import EstimatorCandidate
from obc_ros.ros.conversions import set_stamp
from obc_ros.ros.messages import flatten_doubles

COUNTS = ('used', 'late', 'out of order', 'too late', 'repeated', 'missing', 'not used',
          'not finite', 'malformed', 'outliers', 'restarts', 'faults', 'future')


def estimate_message(mean: delayed_filter.Estimate, delayed: DelayedFilter, frame: str
                     ) -> Estimate:
    """
    Return the message of an estimate.

    Parameters
    ----------
    mean : delayed_filter.Estimate
        The estimate.
    delayed : DelayedFilter
        The filter that made it, for innovation and consistency.
    frame : str
        frame_id of the message.

    """
    message, consistency = Estimate(), delayed.monitor.judge()
    set_stamp(message.header.stamp, mean.stamp)
    message.header.frame_id = frame
    message.x, message.covariance = flatten_doubles(mean.x), flatten_doubles(mean.P)
    message.consistency = consistency.ratio
    message.band = [consistency.lower, consistency.upper]
    message.age = 1e-9 * (mean.stamp - (delayed.newest or mean.stamp))
    if delayed.last is not None:
        names, update = delayed.last
        message.names, message.nis = list(names), update.nis
        message.innovation = flatten_doubles(update.normalized)
    return message


def estimator_status(name: str, candidate: EstimatorCandidate, delayed: DelayedFilter,
                     age: float | None, published: int) -> DiagnosticStatus:
    """
    Return the diagnostics of the estimator.

    Parameters
    ----------
    name : str
        Of the node.
    candidate : EstimatorCandidate
        The settings in use.
    delayed : DelayedFilter
        The filter.
    age : float or None
        Of the newest measurement [s]; None: there was none.
    published : int
        Number of published estimates.

    """
    consistency, settings = delayed.monitor.judge(), candidate.settings
    unseen = [each for each in candidate.outputs if each not in delayed.measured]
    level, words = DiagnosticStatus.OK, str(consistency)
    if age is None:
        level, words = DiagnosticStatus.WARN, 'no measurement yet'
    elif age > settings.measurement_timeout:
        level, words = DiagnosticStatus.ERROR, (
            f'no measurement for {age:.2f} s: no estimate is published')
    elif unseen:
        level, words = DiagnosticStatus.WARN, f'not measured: {", ".join(unseen)}'
    elif consistency.ratio > consistency.upper:
        level = DiagnosticStatus.WARN
    values = {
        'age of the newest measurement [s]': '' if age is None else f'{age:.3f}',
        'estimates published': published,
        'consistency': f'{consistency.ratio:.3f}',
        'band': f'{consistency.lower:.3f} to {consistency.upper:.3f}',
        'design': candidate,
        **{f'measurements {what}': delayed.counts[what] for what in COUNTS}}
    return DiagnosticStatus(name=f'{name}: estimate', level=level, message=words, values=[
        KeyValue(key=key, value=str(value)) for key, value in values.items()])
