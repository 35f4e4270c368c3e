# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numerical methods that do not depend on control theory."""
