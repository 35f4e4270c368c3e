# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A simulated plant over time: integration, pace, sensors."""
