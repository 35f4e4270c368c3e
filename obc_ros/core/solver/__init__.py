# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solution of an optimal control problem with its certificate, or the reason for failure."""
