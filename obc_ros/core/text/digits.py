# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers in sentences that compare them."""

MOST_DIGITS = 17   # with which two doubles that differ are printed differently


def format_distinct(*values: float, digits: int = 4, unit: str = '') -> list[str]:
    """
    Return numbers as text, so that those that differ are printed differently.

    :param digits: significant digits, if they are enough; otherwise the fewest that are.
    """
    while True:
        texts = [f'{value:.{digits}g}' for value in values]
        if len(set(texts)) >= len(set(values)) or digits >= MOST_DIGITS:
            return [f'{text} {unit}'.rstrip() for text in texts]
        digits += 1
