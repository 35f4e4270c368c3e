# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Views of a plant and of a plan for RViz and Foxglove: markers, paths, a frame."""
