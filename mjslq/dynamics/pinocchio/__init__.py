"""Pinocchio models as discrete-time systems: articulated bodies with analytic derivatives, without contacts.

engine              `PinocchioDynamics`, what users meet
simulator, kernels  semi-implicit Euler over a whole horizon; `runge_kutta` the step of fourth order
outputs             frames and their Jacobians
models              reading URDF files, locking joints
"""

from mjslq.dynamics.pinocchio.engine import PinocchioDynamics as PinocchioDynamics
