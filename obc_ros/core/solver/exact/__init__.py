# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Solutions in closed form, or exact up to rounding, of problems with special structure."""
