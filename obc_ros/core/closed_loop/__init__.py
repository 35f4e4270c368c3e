# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Control loop and simulated plant over time."""
