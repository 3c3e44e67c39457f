"""Engines: discrete-time systems that are simulated and linearized over whole horizons."""

from mjslq.dynamics.dynamics import Dynamics as Dynamics
from mjslq.dynamics.dynamics import Linearization as Linearization
