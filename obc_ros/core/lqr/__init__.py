# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The linear quadratic regulator (sections 2.3 to 2.5)."""
