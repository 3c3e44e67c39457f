"""Engines: what turns a state and a control into the next state, over whole horizons at once."""

from mjslq.dynamics._base import Dynamics as Dynamics
from mjslq.dynamics._base import Linearization as Linearization
