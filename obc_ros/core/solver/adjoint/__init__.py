# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Costates and multipliers of a path, mesh refinement, Pontryagin's boundary value problem."""
