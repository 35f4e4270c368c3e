# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Improvement of a path: arcs, mesh points at kinks, the indirect method."""
