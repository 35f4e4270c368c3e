# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Commands that answer the questions in files: `obc solve` and `obc lqr`."""
