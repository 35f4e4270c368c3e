# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""From one path to a better one: arcs, kinks, minima of H, the indirect method."""
