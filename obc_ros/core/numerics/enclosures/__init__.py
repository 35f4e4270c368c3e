# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Enclosures: sets of numbers and states that are proved to contain a result."""
