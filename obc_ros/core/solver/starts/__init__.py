# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Starts beyond the first guesses: rollouts, paths around obstacles, other final times."""
