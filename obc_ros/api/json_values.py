# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Values as JSON has them."""

from collections.abc import Mapping
import math
from typing import Any


def convert_to_json(value: Any) -> Any:
    """
    Return a value with None in place of all numbers that are not finite, for JSON.

    Parameters
    ----------
    value : mapping, sequence, str, bool, number or None
        Sequences are lists and tuples.

    Returns
    -------
    dict, list, str, bool, number or None
        Nested in the same way; tuples become lists.

    """
    if isinstance(value, Mapping):
        return {key: convert_to_json(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [convert_to_json(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
