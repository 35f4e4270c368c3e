# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Loops over DDS with plants of MuJoCo, which computes contacts, constraints and inertia by itself.

MuJoCo makes its steps in the test, in lockstep with the commands.
"""

from collections.abc import Sequence
import math

import mujoco  # see requirements/test.txt
import numpy as np
from obc_ros.core.systems.registry import get_system
import pytest
from robot_bench import LANES, place_beside_lane, RobotBench, see_from_lane
from scipy.spatial.transform import Rotation

pytestmark = [pytest.mark.slow, pytest.mark.nodes]
PERIOD, STEPS = 0.04, 20    # [s], of 2 ms
ACROSS, NEAR = 2e-3, 1e-2   # [m] from a lane, from a set point
OWN = {'lqr_node': {}, 'mpc_node': {'horizon': 0.8}}

# Two driven wheels, two casters without friction; the motors turn the wheels by their speeds.
RADIUS, TRACK = 0.1, 0.3    # [m] of the wheels, between them
CAR = f"""
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body name="car" pos="0 0 {RADIUS}">
      <freejoint/>
      <geom type="box" size="0.2 0.12 0.03" pos="0 0 0.05" mass="6" contype="0" conaffinity="0"/>
      <geom type="sphere" size="0.03" pos="0.15 0 -0.07" mass="0.2" condim="1" priority="1"/>
      <geom type="sphere" size="0.03" pos="-0.15 0 -0.07" mass="0.2" condim="1" priority="1"/>
      <body pos="0 {TRACK / 2} 0"><joint name="left" axis="0 1 0"/>
        <geom type="ellipsoid" size="{RADIUS} 0.02 {RADIUS}" mass="0.5"/></body>
      <body pos="0 -{TRACK / 2} 0"><joint name="right" axis="0 1 0"/>
        <geom type="ellipsoid" size="{RADIUS} 0.02 {RADIUS}" mass="0.5"/></body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="left" kv="2"/>
    <velocity joint="right" kv="2"/>
  </actuator>
</mujoco>
"""
# The aircraft, in the plane of x and z; a positive theta turns about -y. Its motors are at its
# nozzle and, for a wrench, at its centre of mass.
MASS, INERTIA, ARM, GRAVITY, DAMPING = 4.0, 0.0475, 0.25, 9.8, 0.05
AIRCRAFT = f"""
<mujoco>
  <option timestep="0.002" gravity="0 0 -{GRAVITY}" integrator="RK4"/>
  <worldbody>
    <body name="aircraft">
      <joint name="px" type="slide" axis="1 0 0" damping="{DAMPING}"/>
      <joint name="py" type="slide" axis="0 0 1" damping="{DAMPING}"/>
      <joint name="theta" type="hinge" axis="0 -1 0"/>
      <inertial pos="0 0 0" mass="%s" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
      <site name="centre"/>
      <site name="nozzle" pos="0 0 -{ARM}"/>
    </body>
  </worldbody>
  <actuator>
    <motor site="nozzle" gear="1 0 0 0 0 0"/>
    <motor site="nozzle" gear="0 0 1 0 0 0"/>
    <motor site="centre" gear="1 0 0 0 0 0"/>
    <motor site="centre" gear="0 0 1 0 0 0"/>
    <motor site="centre" gear="0 0 0 0 1 0"/>
  </actuator>
</mujoco>
"""
CART, BOB, LENGTH = 1.0, 0.1, 0.5   # [kg], [kg], [m]
CART_POLE = f"""
<mujoco>
  <option timestep="0.002" gravity="0 0 -{GRAVITY}" integrator="RK4"/>
  <worldbody>
    <body>
      <joint name="p" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{CART}" diaginertia="1 1 1"/>
      <body>
        <joint name="theta" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 {LENGTH}" mass="{BOB}" diaginertia="1e-12 1e-12 1e-12"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="p"/></actuator>
</mujoco>
"""
# By Lagrange's equations; theta = 0 is upright, positive to the right.
CART_POLE_SYSTEM = f"""
name: cart_pole
states: [p, theta, v, omega]
inputs: [F]
parameters: {{M: {CART}, m: {BOB}, L: {LENGTH}, g: {GRAVITY}}}
angles: [theta]
dynamics:
  p: v
  theta: omega
  v: (F + m*sin(theta)*(L*omega**2 - g*cos(theta)))/(M + m*sin(theta)**2)
  omega: >-
    ((M + m)*g*sin(theta) - cos(theta)*(F + m*L*omega**2*sin(theta)))/(L*(M + m*sin(theta)**2))
input_bounds: {{F: [-20.0, 20.0]}}
outputs: {{rail: p, tilt: theta}}
"""
# Four rotors give a thrust along the axis of the body, and torques about its axes.
QUADROTOR_MASS, QUADROTOR_INERTIA = 1.2, (0.012, 0.012, 0.022)
QUADROTOR = f"""
<mujoco>
  <option timestep="0.002" gravity="0 0 -{GRAVITY}" integrator="RK4"/>
  <worldbody>
    <body name="quadrotor">
      <freejoint/>
      <inertial pos="0 0 0" mass="{QUADROTOR_MASS}"
                diaginertia="{' '.join(map(str, QUADROTOR_INERTIA))}"/>
      <site name="centre"/>
    </body>
  </worldbody>
  <actuator>
    <motor site="centre" gear="0 0 1 0 0 0"/>
    <motor site="centre" gear="0 0 0 1 0 0"/>
    <motor site="centre" gear="0 0 0 0 1 0"/>
    <motor site="centre" gear="0 0 0 0 0 1"/>
  </actuator>
</mujoco>
"""
# By the equations of Newton and Euler; yaw, pitch and roll turn about z, y and x, in this order.
QUADROTOR_SYSTEM = f"""
name: quadrotor
states: [px, py, pz, roll, pitch, yaw, vx, vy, vz, p, q, r]
inputs: [thrust, tx, ty, tz]
parameters: {{m: {QUADROTOR_MASS}, g: {GRAVITY}, jx: {QUADROTOR_INERTIA[0]},
             jy: {QUADROTOR_INERTIA[1]}, jz: {QUADROTOR_INERTIA[2]}}}
angles: [roll, pitch, yaw]
dynamics:
  px: vx
  py: vy
  pz: vz
  roll: p + (q*sin(roll) + r*cos(roll))*tan(pitch)
  pitch: q*cos(roll) - r*sin(roll)
  yaw: (q*sin(roll) + r*cos(roll))/cos(pitch)
  vx: thrust/m*(cos(yaw)*sin(pitch)*cos(roll) + sin(yaw)*sin(roll))
  vy: thrust/m*(sin(yaw)*sin(pitch)*cos(roll) - cos(yaw)*sin(roll))
  vz: thrust/m*cos(pitch)*cos(roll) - g
  p: (tx - (jz - jy)*q*r)/jx
  q: (ty - (jx - jz)*p*r)/jy
  r: (tz - (jy - jx)*p*q)/jz
input_bounds: {{thrust: [0, 24], tx: [-1, 1], ty: [-1, 1], tz: [-0.3, 0.3]}}
"""
SYSTEMS = {'cart_pole': CART_POLE_SYSTEM, 'quadrotor': QUADROTOR_SYSTEM}
MODELS = {'cart_pole': CART_POLE, 'aircraft': AIRCRAFT % MASS}


class Body:
    """A model whose joints are the states: their positions, then their rates."""

    def __init__(self, model: str, x0: list[float]) -> None:
        self.model = mujoco.MjModel.from_xml_string(model)
        self.data = mujoco.MjData(self.model)
        self.data.qpos, self.data.qvel = np.reshape(x0, (2, -1))

    def measure(self) -> np.ndarray:
        """Return the state (n,)."""
        return np.concatenate([self.data.qpos, self.data.qvel])

    def move(self, message) -> None:
        """Move for a period with the input of a message."""
        if hasattr(message, 'wrench'):
            force, torque = message.wrench.force, message.wrench.torque
            self.data.ctrl = [0.0, 0.0, force.x, force.z, torque.y]
        else:
            self.data.ctrl[:len(message.u)] = message.u
        mujoco.mj_step(self.model, self.data, STEPS)


class Car:
    """A car on its wheels, whose motors follow a twist."""

    def __init__(self, x0: list[float]) -> None:
        self.model = mujoco.MjModel.from_xml_string(CAR)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:2] = x0[:2]
        self.data.qpos[3:7] = math.cos(x0[2] / 2), 0.0, 0.0, math.sin(x0[2] / 2)
        mujoco.mj_forward(self.model, self.data)

    def measure(self) -> np.ndarray:
        """Return (px, py, theta)."""
        ahead = self.data.body('car').xmat
        return np.array([*self.data.qpos[:2], math.atan2(ahead[3], ahead[0])])

    def move(self, message) -> None:
        """Drive for a period with the twist of a message."""
        speed, aside = message.twist.linear.x, message.twist.angular.z * TRACK / 2
        self.data.ctrl = (speed - aside) / RADIUS, (speed + aside) / RADIUS
        mujoco.mj_step(self.model, self.data, STEPS)


class Quadrotor(Body):
    """A body that turns freely, its orientation a quaternion."""

    def __init__(self, x0: Sequence[float]) -> None:
        self.model = mujoco.MjModel.from_xml_string(QUADROTOR)
        self.data = mujoco.MjData(self.model)
        turn = Rotation.from_euler('ZYX', x0[5:2:-1]).as_quat(scalar_first=True)
        self.data.qpos, self.data.qvel = [*x0[:3], *turn], x0[6:]

    def measure(self) -> np.ndarray:
        """Return the state (12,)."""
        turn = Rotation.from_quat(self.data.qpos[3:], scalar_first=True).as_euler('ZYX')
        return np.array([*self.data.qpos[:3], *turn[::-1], *self.data.qvel])


@pytest.mark.parametrize('plant', ['aircraft', 'cart_pole', 'quadrotor'])
def test_the_models_are_those_of_the_plants(tmp_path, plant):
    """Two derivations of the equations give the same accelerations."""
    file = tmp_path / f'{plant}.yaml'
    file.write_text(SYSTEMS.get(plant, ''))
    system = get_system(str(file) if plant in SYSTEMS else plant)
    random = np.random.default_rng(1)
    for _ in range(20):
        x, u = random.uniform(-1.0, 1.0, system.n), random.uniform(-5.0, 5.0, system.m)
        body = Quadrotor(x) if plant == 'quadrotor' else Body(MODELS[plant], x.tolist())
        body.data.ctrl[:system.m] = u
        mujoco.mj_forward(body.model, body.data)
        assert system.f(x, u)[system.n // 2:] == pytest.approx(body.data.qacc, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize('node', ['lqr_node', 'mpc_node'])
def test_a_car_on_wheels_goes_to_its_lane_at_each_heading(spawn, probe, node):
    bench = RobotBench(spawn, probe, node, 'odom', 'cmd_vel', PERIOD, system='two_wheeled',
                       setpoint_input=[0.5, 0.0], u_limits=[1.0, 1.0], **OWN[node])
    for lane in LANES:
        bench.set(setpoint=list(lane))
        bench.begin_anew()
        car = Car(place_beside_lane([0.0, 0.1, 0.1], lane))
        x = bench.run(10.0, car.measure, car.move)
        seen = see_from_lane(x, lane)
        assert np.abs(seen[-10:, 1]).max() < ACROSS
        assert seen[-1, 0] > 4.0   # at half a metre a second


@pytest.mark.parametrize(('node', 'sink'), [('lqr_node', 'command'), ('mpc_node', 'wrench')])
def test_an_aircraft_goes_to_its_set_point(spawn, probe, node, sink):
    bench = RobotBench(spawn, probe, node, 'state', sink, PERIOD, system='aircraft',
                       u_limits=[-6.0, 6.0, 20.0, 60.0], **OWN[node])
    body = Body(AIRCRAFT % MASS, [1.0, -0.5, 0.1, 0.0, 0.0, 0.0])
    x = bench.run(20.0, body.measure, body.move)
    assert np.hypot(*x[-10:, :2].T).max() < NEAR


def test_a_wrong_mass_lowers_the_aircraft_and_integral_action_raises_it(spawn, probe):
    """At rest f2 = m g - k py holds the weight; k = sqrt(q / r) of the vertical motion."""
    true, q = 1.04 * MASS, 100.0
    bench = RobotBench(spawn, probe, 'lqr_node', 'state', 'wrench', PERIOD, system='aircraft',
                       u_limits=[-6.0, 6.0, 20.0, 60.0], Qx=[1.0, q, 1.0, 1.0, 1.0, 1.0],
                       Qu=[1.0, 1.0])
    body = Body(AIRCRAFT % true, [0.0] * 6)
    x = bench.run(12.0, body.measure, body.move)
    offset = -(true - MASS) * GRAVITY / math.sqrt(q)
    assert x[-1, 1] == pytest.approx(offset, rel=1e-3)
    bench.set(integral=['py'], Qi=[10.0])
    x = bench.run(20.0, body.measure, body.move)
    assert np.hypot(*x[-10:, :2].T).max() < NEAR


@pytest.mark.parametrize('node', ['lqr_node', 'mpc_node'])
def test_a_pole_is_balanced_on_a_cart(spawn, probe, tmp_path, node):
    file = tmp_path / 'cart_pole.yaml'
    file.write_text(CART_POLE_SYSTEM)
    bench = RobotBench(spawn, probe, node, 'state', 'command', PERIOD, system=str(file),
                       u_limits=[20.0], **OWN[node])
    body = Body(CART_POLE, [0.3, 0.2, 0.0, 0.0])
    x = bench.run(10.0, body.measure, body.move)
    assert np.abs(x[-10:, :2]).max() < NEAR


@pytest.mark.parametrize('node', ['lqr_node', 'mpc_node'])
def test_a_pole_is_balanced_by_its_position_and_angle(spawn, probe, tmp_path, node):
    """The estimator finds the speeds."""
    file = tmp_path / 'cart_pole.yaml'
    file.write_text(CART_POLE_SYSTEM)
    bench = RobotBench(
        spawn, probe, node, 'measurement', 'command', PERIOD, system=str(file), u_limits=[20.0],
        estimator={'system': str(file), 'outputs': ['rail', 'tilt'], 'sample_time': PERIOD,
                   'Qw': [0.0, 0.0, 0.1, 0.1], 'Rv': [1e-6, 1e-6], 'x0_deviation': [0.5]},
        **OWN[node])
    body = Body(CART_POLE, [0.2, 0.1, 0.0, 0.0])
    x = bench.run(10.0, lambda: body.measure()[:2], body.move)
    assert np.abs(x[-10:]).max() < NEAR


@pytest.mark.parametrize('node', ['lqr_node', 'mpc_node'])
def test_a_quadrotor_turns_and_goes_to_its_set_point(spawn, probe, tmp_path, node):
    file = tmp_path / 'quadrotor.yaml'
    file.write_text(QUADROTOR_SYSTEM)
    there = [1.0, -0.5, 0.5, 0.0, 0.0, 1.0, *[0.0] * 6]
    bench = RobotBench(
        spawn, probe, node, 'state', 'command', PERIOD, system=str(file), setpoint=there,
        setpoint_input=[QUADROTOR_MASS * GRAVITY, 0.0, 0.0, 0.0], Qu=[1.0, 20.0, 20.0, 20.0],
        u_limits=[0.0, 24.0, -1.0, 1.0, -1.0, 1.0, -0.3, 0.3], **OWN[node])
    body = Quadrotor([0.5, 0.0, 0.0, 0.1, -0.1, 0.5, *[0.0] * 6])
    x = bench.run(15.0, body.measure, body.move)
    assert np.abs(x[-10:, :6] - there[:6]).max() < NEAR
