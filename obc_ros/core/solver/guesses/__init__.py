# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Initial guesses and scales from the numbers of a statement."""
