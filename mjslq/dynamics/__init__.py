"""Engines: what turns a state and a control into the next state, over whole horizons at once."""

from mjslq.dynamics.dynamics import Dynamics as Dynamics
from mjslq.dynamics.dynamics import Linearization as Linearization
