# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Objects of the public interface `import obc_ros.core as obc`."""
