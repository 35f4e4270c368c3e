# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sweeps: one problem solved for many values of its numbers, here or on a cluster."""
