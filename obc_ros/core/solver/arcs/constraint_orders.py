# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Orders of state constraints: derivatives in time until inputs occur."""

import casadi as ca
import numpy as np
from obc_ros.core.numerics.arrays import Mask
from obc_ros.core.numerics.instructions import find_dependence
from obc_ros.core.ocp.problem import Problem

_ORDERS = 3    # highest order of a constraint that is treated


class BoundRates:
    """
    The rows of (x, c) and their time derivatives up to the first in which inputs occur.

    Attributes
    ----------
    count : int
        n + l, the number of rows.
    orders : ndarray of int, shape (n + l,)
        Order of that derivative; 0: inputs occur in the row itself; -1: in none up to _ORDERS.
    deciding : ndarray of bool, shape (n + l, m)
        Inputs that occur in it.
    straight : ndarray of bool, shape (n + l,)
        Whether the row itself has inputs and is linear in them.
    chains : list of list of SX
        For each row the row and its derivatives.

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
                    self.deciding[row] = find_dependence(chain[-1], problem.u)[0]
                    slope = ca.jacobian(chain[-1], problem.u)
                    self.straight[row] = not order and not ca.depends_on(slope, problem.u)
                    break
                chain.append(ca.jtimes(chain[-1], problem.x, problem.f))
            self.chains.append(chain)
