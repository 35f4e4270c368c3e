# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The entries in the order of the chapter."""

from obc_ros.cli.gallery.entries import (
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

ENTRIES = (
    optimization.EXAMPLE_2_1, principle.THEOREM_2_1, scalar.EXAMPLE_2_2, least_time.EXAMPLE_2_3,
    regulators.THEOREM_2_2, regulators.EXAMPLE_2_4, aircraft.WEIGHTS_2_5,
    least_time.EXAMPLE_2_6, optimization.EXERCISE_2_1, shortest.EXERCISE_2_2,
    shortest.EXERCISE_2_3, flat.EXERCISE_2_4, flat.EXERCISE_2_5, two_wheeled.EXERCISE_2_6,
    linear.EXERCISE_2_7, linear.EXERCISE_2_8, scalar.EXERCISE_2_9, vehicle.EXERCISE_2_10)
