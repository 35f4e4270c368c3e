# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The panels beside the picture of a live page, one file for each."""
