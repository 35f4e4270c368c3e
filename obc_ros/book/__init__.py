# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `obc gallery`: examples of the book, kept or by running nodes; sheets, slides."""
