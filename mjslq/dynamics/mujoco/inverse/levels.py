"""The kernels of Jacobians and second derivatives, one for each level of what a model needs.

What a model does not need would take long to make machine code of. The functions themselves, of many modules, are
imported only where numba has to compile them.
"""

from __future__ import annotations

import functools

from mjslq.dynamics.mujoco.kernels import LOOP
from mjslq.native.kernel import Kernel, deferred

SMOOTH, CONSTRAINED, FEELING, WHOLE = range(4)
"""How much there is to a kernel, each level with all of those before it: rigid bodies, springs, dampers, actuators with
constant moment arms and sensors of motion; constraints, contacts among them; sensors of accelerations, contacts and
limits, and those without a closed form; fluids, moving moment arms, forces without a closed form, the discrete
integrator's metric."""
NAMES = ("smooth", "constrained", "feeling", "whole")
_HOME = "mjslq.dynamics.mujoco.inverse"


@functools.cache
def jacobians(level: int) -> Kernel:
    """The loop over the horizon that writes Jacobians."""
    switches = (level >= CONSTRAINED, level >= FEELING, level >= WHOLE)
    return deferred(f"mujoco-inverse-{NAMES[level]}", LOOP, f"{_HOME}.kernel", "make_loop", switches)


@functools.cache
def second_derivatives(constrained: bool, feeling: bool) -> Kernel:
    """The loop over the knots that writes second derivatives: with constraint rows, and with sensors by differences."""
    name = f"mujoco-curvature{'-constrained' * constrained}{'-feeling' * feeling}"
    return deferred(name, LOOP, f"{_HOME}.curvature.kernel", "make_loop", (constrained, feeling))


def kernels() -> list[Kernel]:
    """All of them."""
    bending = [second_derivatives(rows, feeling) for rows in (False, True) for feeling in (False, True)]
    return [jacobians(level) for level in range(len(NAMES))] + bending
