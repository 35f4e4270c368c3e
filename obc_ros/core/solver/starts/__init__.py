# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Initial guesses: lines, rollouts, paths around obstacles, neighbours; multistart."""
