# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A plant dx/dt = f(x, u; p): its definition, the registered ones, equilibria."""
