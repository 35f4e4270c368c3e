# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Riccati equations: algebraic ones solved with a proof, differential ones joined."""
