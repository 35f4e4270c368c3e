# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Reasons why a problem has no solution, found by solving related problems."""
