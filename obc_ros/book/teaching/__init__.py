# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exercise sheets of the chapter: questions, and how answers are checked."""
