# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Processes that handle requests within time limits: pool, process, wire format, each kind."""
