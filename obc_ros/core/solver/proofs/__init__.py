# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is proved of a problem from its expressions: contradictions, optimality."""
