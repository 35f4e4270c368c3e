# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Settings, plans and diagnostics of mpc_node."""
