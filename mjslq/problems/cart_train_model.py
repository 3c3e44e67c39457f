"""The train of carts and pendulums of `cart_train`: its parameters, and the MJCF model with springs as tendons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.dynamics.mujoco import MujocoDynamics

COLORS = ((0.93, 0.42, 0.16, 1.0), (0.20, 0.45, 0.72, 1.0), (0.17, 0.56, 0.43, 1.0), (0.84, 0.66, 0.18, 1.0))
"""Of the carts, in turn."""


@dataclass(frozen=True)
class Train:
    """Parameters of the train; ours, since the paper's are lost."""

    carts: int
    cart_mass: float = 1.0
    """M. [kg]"""
    bob_mass: float = 0.2
    """m. [kg]"""
    length: float = 0.3
    """l, from the hinge to the bob's centre. [m]"""
    bob_radius: float = 0.04
    """b. [m]"""
    stiffness: float = 5.0
    """k, between neighbours. [N/m]"""
    damping: float = 0.5
    """d, between neighbours. [Ns/m]"""
    rail_damping: float = 0.1
    """f_c, of each cart. [Ns/m]"""
    hinge_damping: float = 0.005
    """f_p, of each pendulum. [Nms/rad]"""
    gravity: float = 9.81
    """g. [m/s^2]"""
    spacing: float = 1.0
    """Between the places of neighbours, for the MJCF model alone. [m]"""

    @property
    def inertia(self) -> float:
        """Of a pendulum about its hinge. [kg m^2]"""
        return self.bob_mass * (self.length**2 + 0.4 * self.bob_radius**2)

    @property
    def parameters(self) -> Array:
        """What the compiled function takes. Shape (8,)."""
        return np.array(
            [self.cart_mass + self.bob_mass, self.bob_mass * self.length, self.inertia, self.gravity,
             self.stiffness, self.damping, self.rail_damping, self.hinge_damping]
        )  # fmt: skip


def mjcf(train: Train, timestep: float, limits: tuple[float, float] | None = None) -> str:
    """The train as MJCF text: a slide and a hinge a cart, a spatial tendon with stiffness and damping a coupling."""
    half = 0.5 * train.spacing * (train.carts - 1)
    bodies, tendons, motors = [], [], []
    clamp = "" if limits is None else f' ctrlrange="{limits[0]!r} {limits[1]!r}"'
    for i in range(train.carts):
        color = " ".join(f"{part:g}" for part in COLORS[i % len(COLORS)])
        bodies.append(f"""
    <body name="cart{i + 1}" pos="{i * train.spacing - half!r} 0 0">
      <joint name="cart{i + 1}" type="slide" axis="1 0 0" damping="{train.rail_damping!r}"/>
      <geom type="box" size="0.11 0.07 0.04" mass="{train.cart_mass!r}" rgba="{color}"/>
      <geom type="cylinder" fromto="-0.07 -0.08 -0.04 -0.07 0.08 -0.04" size="0.03" mass="0" rgba="0.17 0.2 0.26 1"/>
      <geom type="cylinder" fromto="0.07 -0.08 -0.04 0.07 0.08 -0.04" size="0.03" mass="0" rgba="0.17 0.2 0.26 1"/>
      <site name="middle{i + 1}" size="0.012"/>
      <body name="pole{i + 1}">
        <joint name="pole{i + 1}" type="hinge" axis="0 1 0" damping="{train.hinge_damping!r}"/>
        <geom type="capsule" fromto="0 0 0 0 0 {train.length!r}" size="0.012" mass="0" rgba="0.62 0.66 0.72 1"/>
        <geom type="sphere" pos="0 0 {train.length!r}" size="{train.bob_radius!r}" mass="{train.bob_mass!r}"
          rgba="{color}"/>
      </body>
    </body>""")
        motors.append(f'<motor name="force{i + 1}" joint="cart{i + 1}"{clamp}/>')
        if i:
            tendons.append(
                f'<spatial name="spring{i}" stiffness="{train.stiffness!r}" damping="{train.damping!r}" '
                f'springlength="{train.spacing!r}" width="0.008" rgba="0.4 0.45 0.52 1">'
                f'<site site="middle{i}"/><site site="middle{i + 1}"/></spatial>'
            )
    return f"""
<mujoco model="cart_train">
  <compiler autolimits="true"/>
  <option timestep="{timestep!r}" integrator="RK4" gravity="0 0 {-train.gravity!r}"><flag contact="disable"/></option>
  <statistic center="0 0 0.15" extent="{max(1.6, 0.7 * train.spacing * train.carts)!r}"/>
  <visual><headlight ambient="0.38 0.38 0.4" diffuse="0.45 0.45 0.45" specular="0.2 0.2 0.2"/>
    <rgba haze="0.86 0.90 0.95 1"/><global azimuth="90" elevation="-8"/></visual>
  <asset><texture name="sky" type="skybox" builtin="gradient" rgb1="0.93 0.96 0.99" rgb2="0.66 0.76 0.87" width="256"
    height="256"/></asset>
  <worldbody>
    <light pos="0 -2 3" dir="0 0.5 -1"/>
    <geom type="capsule" fromto="{-half - 2.5!r} 0 -0.085 {half + 2.5!r} 0 -0.085" size="0.015" mass="0"
      rgba="0.62 0.66 0.72 1"/>{"".join(bodies)}
  </worldbody>
  <tendon>{"".join(tendons)}</tendon>
  <actuator>{"".join(motors)}</actuator>
</mujoco>"""


def mujoco_dynamics(train: Train, timestep: float, limits: tuple[float, float] | None = None) -> MujocoDynamics:
    """The MJCF model as an engine; its state is the compiled function's."""
    from mjslq.dynamics.mujoco import MujocoDynamics

    return MujocoDynamics.from_xml(mjcf(train, timestep, limits))
