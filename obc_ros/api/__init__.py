# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The public interface, `import obc_ros as obc`: problems, answers, regulators, figures."""
