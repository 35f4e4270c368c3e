# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the commands share on a terminal: arguments, completion, progress, tables."""
