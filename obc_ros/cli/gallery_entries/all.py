# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The entries in the order of the chapter."""

from obc_ros.cli.gallery_entries import scalar

ENTRIES = (scalar.EXAMPLE_2_2, scalar.EXERCISE_2_9)
