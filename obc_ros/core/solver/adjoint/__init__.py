# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Costates and multipliers of a path, and what they say of its mesh."""
