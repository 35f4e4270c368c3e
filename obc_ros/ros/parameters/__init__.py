# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: one table, judged together, adopted at once."""
