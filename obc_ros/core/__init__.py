# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The numerical core: dynamics -> problem -> solution -> certificate; knows no ROS."""
