# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The order of the search: coarse mesh, solved neighbours, further starts and their end."""
