# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `obc gallery`: the chapter's examples, answered by running nodes."""
