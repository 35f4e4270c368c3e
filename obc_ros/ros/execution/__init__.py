# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The executor of a node, and the threads beside it."""
