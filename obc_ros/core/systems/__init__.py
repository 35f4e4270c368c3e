# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Controlled systems dx/dt = f(x, u; p): definition, registry, files and equilibria."""
