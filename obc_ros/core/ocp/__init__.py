# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The optimal control problem of section 2.2: statement, structure, solution."""
