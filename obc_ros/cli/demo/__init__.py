# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `obc demo`: a closed loop over DDS, recorded and plotted."""
