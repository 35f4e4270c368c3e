# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The order of the entries, and those for Section 2.4 and a counterexample."""
