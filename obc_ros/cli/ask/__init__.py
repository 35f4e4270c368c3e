# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Commands for the problems and regulators of files: `obc solve`, `obc lqr`, `obc sweep`."""
