# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes that are started together: what a signal to their parent does."""

import signal

from obc_ros.cli.processes import Children, InterruptedByUserError
import pytest


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_is_told_to_all_that_are_open_and_to_none_later(tmp_path, number):
    before = signal.getsignal(number)
    with Children(tmp_path / 'outer') as outer:
        signal.raise_signal(number)
        with (Children(tmp_path / 'inner') as inner,
              pytest.raises(InterruptedByUserError, match=number.name)):
            inner.check()
        with pytest.raises(InterruptedByUserError, match=number.name):
            outer.check()
    with Children(tmp_path / 'later') as later:
        later.check()
    assert signal.getsignal(number) is before


def test_a_folder_that_cannot_be_made_leaves_the_signals_alone(tmp_path):
    (tmp_path / 'file').touch()
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(OSError), Children(tmp_path / 'file' / 'log'):
        pass
    assert signal.getsignal(signal.SIGINT) is before
