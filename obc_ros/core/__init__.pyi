# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
from obc_ros.core.library.answer import Answer as Answer
from obc_ros.core.library.motions import minimize as minimize
from obc_ros.core.library.motions import plan as plan
from obc_ros.core.library.motions import reeds_shepp as reeds_shepp
from obc_ros.core.library.plants import equilibrium as equilibrium
from obc_ros.core.library.plants import System as System
from obc_ros.core.library.plants import systems as systems
from obc_ros.core.library.problem import Problem as Problem
from obc_ros.core.library.regulators import dlqr as dlqr
from obc_ros.core.library.regulators import finite_horizon as finite_horizon
from obc_ros.core.library.regulators import lqr as lqr
from obc_ros.core.library.simulation import simulate as simulate
from obc_ros.core.library.solving import certify as certify
from obc_ros.core.library.solving import solve as solve
from obc_ros.core.text.errors import ObcError as ObcError
from obc_ros.sweep.sweep import sweep as sweep
