# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
from obc_ros.api.answer import Answer as Answer
from obc_ros.api.estimators import dlqe as dlqe
from obc_ros.api.estimators import lqe as lqe
from obc_ros.api.motions import minimize as minimize
from obc_ros.api.motions import plan as plan
from obc_ros.api.motions import reeds_shepp as reeds_shepp
from obc_ros.api.plants import equilibrium as equilibrium
from obc_ros.api.plants import System as System
from obc_ros.api.plants import systems as systems
from obc_ros.api.problem import Problem as Problem
from obc_ros.api.regulators import dlqr as dlqr
from obc_ros.api.regulators import finite_horizon as finite_horizon
from obc_ros.api.regulators import lqr as lqr
from obc_ros.api.simulation import simulate as simulate
from obc_ros.api.solving import certify as certify
from obc_ros.api.solving import solve as solve
from obc_ros.api.sweep import sweep as sweep
from obc_ros.core.solver.program_cache import Cache as Cache
from obc_ros.core.text.errors import ObcError as ObcError

__version__: str
