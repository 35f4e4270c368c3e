# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Verified regulators for a set point or a reference, from a plant and weights."""
