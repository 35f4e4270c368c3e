# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Answers in closed form, or exact to rounding, for problems of special structure."""
