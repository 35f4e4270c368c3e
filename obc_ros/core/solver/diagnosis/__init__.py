# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Why a problem has no answer, found by solving problems beside it."""
