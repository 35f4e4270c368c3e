# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A supervised child process: its start, its limits and its real-time priority."""
