# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""From a plant, a set point or a reference and weights to a proved regulator."""
