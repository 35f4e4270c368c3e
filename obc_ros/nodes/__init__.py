# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: each converts a message to values, calls the core, and converts back."""
