# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a user wrote: expressions, YAML files and fields, read safely; errors in words."""
