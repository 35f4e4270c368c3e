# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures: one style for the screen and for print, their files, those of answers, bodies."""
