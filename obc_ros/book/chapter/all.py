# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The entries in the order of the chapter, and those beyond it."""

from obc_ros.book.chapter import detectability, riccati_equation
from obc_ros.book.entries import (
    aircraft,
    flat,
    least_time,
    linear,
    optimization,
    principle,
    regulators,
    scalar,
    shortest,
    two_wheeled,
    vehicle,
)
from obc_ros.book.next_chapters import doyle, kalman_filters, receding_horizons

ENTRIES = (
    optimization.EXAMPLE_2_1, principle.SECTION_2_2, principle.THEOREM_2_1,
    scalar.EXAMPLE_2_2, least_time.EXAMPLE_2_3, riccati_equation.SECTION_2_4,
    regulators.THEOREM_2_2, detectability.COUNTEREXAMPLE_2_2, regulators.EXAMPLE_2_4,
    aircraft.SECTION_2_5, aircraft.FIGURE_2_3, aircraft.WEIGHTS_2_5,
    least_time.EXAMPLE_2_6, optimization.EXERCISE_2_1, shortest.EXERCISE_2_2,
    shortest.EXERCISE_2_3, flat.EXERCISE_2_4, flat.EXERCISE_2_5, two_wheeled.EXERCISE_2_6,
    linear.EXERCISE_2_7, linear.EXERCISE_2_8, scalar.EXERCISE_2_9, vehicle.EXERCISE_2_10,
    kalman_filters.ESTIMATION_1, kalman_filters.ESTIMATION_2, doyle.ESTIMATION_3,
    receding_horizons.RECEDING_HORIZON_1, receding_horizons.RECEDING_HORIZON_2)
