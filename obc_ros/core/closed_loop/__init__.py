# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The control loop: clock, modes, laws and gate, from a state to its command."""
