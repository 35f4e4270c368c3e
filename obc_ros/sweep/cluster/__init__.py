# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Work on a cluster of Dask: connection, tasks of its workers, sweeps, requests of a server."""
