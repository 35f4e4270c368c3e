# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Expressions and their symbols as one function, which pickles; CasADi's symbols do not."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class PackedExpressions:
    """Columns of symbols, by their names, and a function of them that returns expressions."""

    names: tuple[tuple[str, ...], ...]
    program: ca.Function

    def unpack(self) -> tuple[list[ca.SX], list[ca.SX]]:
        """Return columns of new symbols, and the expressions in them."""
        columns = [ca.vertcat(ca.SX(0, 1), *map(ca.SX.sym, names)) for names in self.names]
        return columns, self.program.call(columns)


def pack_expressions(columns: Sequence[ca.SX], expressions: Sequence[ca.SX]) -> PackedExpressions:
    """Return expressions in columns of symbols."""
    names = tuple(tuple(column[k].name() for k in range(column.numel())) for column in columns)
    return PackedExpressions(names, ca.Function('packed', list(columns), list(expressions)))
