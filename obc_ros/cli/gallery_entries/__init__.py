# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The entries of the gallery, in the order of the chapter; a module for each kind of question."""
