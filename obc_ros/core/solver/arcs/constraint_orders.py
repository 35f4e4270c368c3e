# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How often bounds of the state and path constraints are differentiated until inputs enter."""

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Mask
from obc_ros.core.ocp.problem import Problem

_ORDERS = 3    # derivatives of a bound that are looked at


class BoundRates:
    """
    The rows of (x, c) of a problem, and their derivatives up to the one that inputs enter.

    Attributes
    ----------
    orders : ndarray, shape (n + l,)
        Of that derivative; -1 where no input enters those that are looked at.
    deciding : ndarray, shape (n + l, m)
        Which inputs enter it.
    straight : ndarray, shape (n + l,)
        Whether the row itself is linear in inputs.
    chains : list of list
        The row and its derivatives.

    """

    def __init__(self, problem: Problem) -> None:
        rows = ca.vertcat(problem.x, problem.path)
        self.count = int(rows.numel())
        self.orders = np.full(self.count, -1)
        self.deciding: Mask = np.zeros((self.count, problem.m), dtype=bool)
        self.straight: Mask = np.zeros(self.count, dtype=bool)
        self.chains: list[list[ca.SX]] = []
        for row, value in enumerate(ca.vertsplit(rows)):
            chain = [value]
            for order in range(_ORDERS + 1):
                if ca.depends_on(chain[-1], problem.u):
                    self.orders[row] = order
                    enters = ca.jacobian_sparsity(chain[-1], problem.u).get_triplet()[1]
                    self.deciding[row, enters] = True
                    slope = ca.jacobian(chain[-1], problem.u)
                    self.straight[row] = not order and not ca.depends_on(slope, problem.u)
                    break
                chain.append(ca.jtimes(chain[-1], problem.x, problem.f))
            self.chains.append(chain)
