# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What lqr_node and mpc_node share: the node and its loop, parameters, commands, diagnostics."""
