"""The catalogue: problems that come with mjslq, each with the numbers that its paper reports.

names()                        the problems there are
get("hopper", height=30.0)     one of them, with its parameters
parameters("hopper")           what can be set, and the defaults
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Callable
from typing import Any

from mjslq.problem import Problem
from mjslq.validation import choose

# Modules are imported when their problem is asked for: one may need an engine that another does not.
_CATALOGUE = {
    "drag_particle": "a particle pushed through quadratic drag (Sideris and Bobrow 2005, section 4.1)",
    "solo12_stand": "the quadruped Solo12 rises from a crouch and stands",
    "g1_reach": "the humanoid G1 reaches for a point, standing on both feet",
    "solo12_flip": "the quadruped Solo12 flips backward and stands again",
    "solo12_jump": "the quadruped Solo12 jumps and stands again",
    "g1_push": "the humanoid G1 is pushed and recovers its stance",
    "g1_clip": "the humanoid G1 tracks a recorded motion: a squat, a wave, a step",
    "hopper": "a gas-actuated hopping machine that reaches a height (Sideris and Bobrow 2005, section 4.2)",
    "van_der_pol": "a Van der Pol oscillator brought to rest (Fukushima and Yamamoto 1986, section IV)",
    "cart_pole": "a pole on a cart swings up, the force limited",
    "double_pendulum": "a double pendulum swings up by two limited motors",
    "acrobot": "a double pendulum swings up by one motor in its elbow",
    "three_samples": "a mass on a line passes three places, its first speed free (McQuade 1989, section 3.6)",
    "bryson_denham": "a particle turns round before a wall (McQuade 1989, Example 1)",
    "drag_cart": "a cart with drag under a limit of dynamic pressure (McQuade 1989, Example 2)",
    "reentry": "a lifting vehicle enters the atmosphere within 5 g (McQuade 1989, chapter 5)",
    "spacecraft_slew": "a spacecraft with a flexible boom turns round, from rest to rest",
    "cart_pole_track": "a pole on a cart swings up on a short track, the end met exactly",
    "quadrotor_obstacles": "a planar quadrotor flies past two discs",
    "car_obstacles": "a car parks past three discs",
    "arm_obstacle": "an arm of three links swings its hand round a disc",
    "double_integrator_time": "a mass on a line goes from rest to rest in the least time",
    "cart_pole_time": "a pole on a cart swings up in the least time, the force limited",
    "cart_train": "carts with pendulums, coupled by springs, that swing between two angles (Sforni et al., GoPRONTO)",
    "box_push": "a finger pushes a box over a floor to a place, and turns it",
    "quadrotor": "a quadrotor flies to a waypoint, its thrusts limited",
    "panda_obstacle": "a seven-joint arm reaches round a ball, within the limits of joints and motors",
    "panda_reach": "a seven-joint arm that reaches for a point, on MuJoCo or Pinocchio",
}


def names() -> list[str]:
    """Names of the problems.

    Returns
    -------
    list of str
        In no particular order.

    Examples
    --------
    >>> "hopper" in mjslq.problems.names()
    True
    """
    return list(_CATALOGUE)


def summary(name: str) -> str:
    """Say in one line what a problem is about.

    Parameters
    ----------
    name : str
        One of `names`.

    Returns
    -------
    str
        The line.

    Raises
    ------
    ValueError
        For an unknown name.

    Examples
    --------
    >>> mjslq.problems.summary("cart_pole_track")
    'a pole on a cart swings up on a short track, the end met exactly'
    """
    return _CATALOGUE[choose("problem", name, _CATALOGUE)]


def parameters(name: str) -> dict[str, Any]:
    """List what can be set in a problem.

    Parameters
    ----------
    name : str
        One of `names`.

    Returns
    -------
    dict
        Parameter -> default.

    Raises
    ------
    ValueError
        For an unknown name.

    Examples
    --------
    >>> mjslq.problems.parameters("hopper")["height"]
    20.0
    """
    return {p.name: p.default for p in inspect.signature(_maker(name)).parameters.values()}


def get(name: str, **values: Any) -> Problem:
    """Make a problem of the catalogue.

    Parameters
    ----------
    name : str
        One of `names`.
    **values
        Parameters that differ from their defaults; `parameters` lists them.

    Returns
    -------
    Problem
        With its parameters on record.

    Raises
    ------
    ValueError
        For an unknown name or parameter, listing those there are, and for values out of range.

    Examples
    --------
    >>> problem = mjslq.problems.get("hopper", height=30.0)
    >>> problem.horizon, problem.dynamics.nu
    (100, 1)
    """
    known = parameters(name)
    for key in values:
        choose(f"parameter of {name}", key, known)
    for key, value in values.items():
        _check_kind(name, key, value, known[key])
    made = _maker(name)(**values)
    return dataclasses.replace(made, name=name, parameters=known | values)


def _maker(name: str) -> Callable[..., Problem]:
    choose("problem", name, _CATALOGUE)
    return getattr(importlib.import_module(f"mjslq.problems.{name}"), name)


def _check_kind(problem: str, key: str, value: Any, default: Any) -> None:
    """A text where a number belongs (and the reverse) is refused here, for all problems alike."""
    if isinstance(default, str) != isinstance(value, str) or value is None:
        kind = "a text" if isinstance(default, str) else "a number"
        raise ValueError(f"{problem}: {key} must be {kind} such as {default!r}, got {value!r}")
