# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Entries on estimation and receding horizons, which chapter 2 of the book does not have."""
