# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tasks in other terms than an optimal control problem: a motion of a system, a static minimum."""
