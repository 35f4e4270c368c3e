# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The receding horizon: its problem, its steps and the terminal set of the regulator."""
