# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solution of nonlinear programs: interior point and the meter."""
