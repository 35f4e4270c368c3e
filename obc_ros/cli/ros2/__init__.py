# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Commands with the names, arguments and output of `ros2`, if it is not installed."""
