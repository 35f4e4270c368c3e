# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Transcription of an optimal control problem on a mesh to a nonlinear program."""
