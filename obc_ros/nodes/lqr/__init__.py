# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What belongs to lqr_node: settings, topics, diagnostics, messages."""
