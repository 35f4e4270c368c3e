# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arcs of a path on which inputs or constraints are at bounds, and collocation on them."""
