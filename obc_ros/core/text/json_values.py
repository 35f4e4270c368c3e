# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Values as JSON has them."""

from collections.abc import Mapping
import math
from typing import Any


def convert_to_json(value: Any) -> Any:
    """Return a value with None in place of numbers that are not finite, and lists for tuples."""
    if isinstance(value, Mapping):
        return {key: convert_to_json(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [convert_to_json(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
