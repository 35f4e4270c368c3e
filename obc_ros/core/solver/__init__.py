# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""From a problem to its certified answer, or to the reason why there is none."""
