# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What nodes and commands share: messages, quality of service, the executor of a node."""
