# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Riccati equations: algebraic ones with an error bound, differential ones by doubling."""
