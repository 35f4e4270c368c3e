# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Settings, gain schedule, references and weight suggestions of lqr_node."""
