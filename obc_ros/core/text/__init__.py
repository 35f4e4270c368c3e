# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""User input: expressions, YAML files and fields, read safely; the errors of the package."""
