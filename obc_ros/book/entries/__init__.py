# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The entries of the gallery, in modules by the kind of problem."""
