# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers that a sentence compares are printed differently if they differ."""

import math

from hypothesis import given, strategies
from obc_ros.core.text.tables import format_distinct

FINITE = strategies.floats(-1e300, 1e300)


@given(FINITE, FINITE)
def test_texts_are_equal_only_if_the_numbers_are(a, b):
    one, other = format_distinct(a, b)
    assert (one == other) == (a == b) or a == b == 0.0   # 0 and -0 are equal numbers
    assert math.isclose(float(one), a, rel_tol=1e-3, abs_tol=1e-320)


def test_four_digits_are_kept_if_they_are_enough():
    assert format_distinct(0.123456, 0.2) == ['0.1235', '0.2']
    assert format_distinct(0.31441, 0.31437) == ['0.31441', '0.31437']
    assert format_distinct(1.0, 1.0, unit='m/s') == ['1 m/s', '1 m/s']
    assert format_distinct(math.nan, 0.5) == ['nan', '0.5']
