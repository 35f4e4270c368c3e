# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Proofs from the expressions of a problem: contradictions, optimality, existence."""
