# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Nonlinear programs: methods, and how their progress is watched."""
