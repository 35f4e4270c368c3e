# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Optimal control as numbers: plants, regulators, problems, answers, certificates; no ROS."""
