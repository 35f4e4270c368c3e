# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""An optimal control problem on a mesh as a nonlinear program."""
