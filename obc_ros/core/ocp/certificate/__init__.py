# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conditions of optimality, judged from the problem and the answer alone."""
