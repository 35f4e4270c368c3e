# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Processes that answer requests within their time: pool, process, wire format, requests."""
