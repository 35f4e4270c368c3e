# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plans of motions for trajectory_server: where they begin, their plants, what lqr_node says."""
