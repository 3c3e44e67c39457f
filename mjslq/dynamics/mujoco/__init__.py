"""MuJoCo models as discrete-time systems: the engine, its compiled kernels, and what they are made of.

    engine      `MujocoDynamics`, what users meet
    simulator   whole-horizon calls on compiled `kernels`, threads by `library`
    inverse/    Jacobians of the step through its inverse dynamics
    states      the state space, with quaternions
    files, checks, names, report    reading models, refusing some, naming and describing their parts

Importing this loads neither MuJoCo nor numba; making an engine does.
"""

from mjslq.dynamics.mujoco.engine import MujocoDynamics as MujocoDynamics
