# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Commands with the words, arguments and output of `ros2`, for where it is not installed."""
