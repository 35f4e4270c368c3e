# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The process that solves the steps of a receding horizon, and the thread that supervises it."""
