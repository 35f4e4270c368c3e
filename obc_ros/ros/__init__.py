# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Shared by nodes and commands: messages, parameters, quality of service, executor."""
