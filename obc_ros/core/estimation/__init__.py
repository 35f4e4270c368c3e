# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of states from outputs: Kalman filters, their consistency, output feedback."""
