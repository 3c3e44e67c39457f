"""Recorded motions as targets: files, resampling, costs on frames, starting guesses.

clip = mjslq.clips.load("wave.csv")
robot = mjslq.MujocoDynamics.from_path("g1.xml", substeps=2, frames=clip.frames)
problem = mjslq.Problem(robot, 50, clip.states(robot, 0.0), [mjslq.costs.Control(1e-3), *clip.costs(robot)])
result = mjslq.solve(problem, X0=clip.guess(problem))

clip         what is recorded, checked
resampling   what it is at other times
following    costs, states and signals to follow
files        npz and CSV
"""

from mjslq.clips.clip import Clip as Clip
from mjslq.clips.files import load as load
from mjslq.clips.resampling import Timing as Timing

__all__ = ["Clip", "Timing", "load"]
