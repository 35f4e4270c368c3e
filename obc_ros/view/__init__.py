# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The live page of a loop or of a recording, in a browser."""
