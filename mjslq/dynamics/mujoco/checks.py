"""Refusal of MuJoCo models that cannot be optimized, such as those whose state is more than (qpos, qvel, act)."""

from __future__ import annotations

import copy
from collections.abc import Callable

import mujoco
import numpy as np

from mjslq.validation import choose, positive

INTEGRATORS = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
}
"""MuJoCo's integrators by name."""
_NO_INERTIA = 1e-11
"""Inertia that a joint has only because the compiler gives massless bodies a tiny one."""
_MANY = 200
"""Iterations after which a constraint solver has converged."""
_UNFELT = ("_", "cam_", "light_", "mat_", "tex_", "skin_", "numeric_", "tuple_", "key_", "bvh_", "oct_")
"""Beginnings of the names of fields that no step depends on, or that follow from others. Keyframes are checked where
they are used."""
_CALLBACKS = ("control", "passive", "act_dyn", "act_gain", "act_bias", "sensor", "contactfilter")

REFUSALS: tuple[tuple[Callable[[mujoco.MjModel], bool], str], ...] = (
    (lambda m: m.nv == 0, "it has no joints, so nothing can move; give a body a joint"),
    (
        lambda m: bool(m.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP),
        'sleeping is enabled, and who sleeps is not part of the state x; use <flag sleep="disable"/>',
    ),
    (
        lambda m: bool(m.opt.enableflags & mujoco.mjtEnableBit.mjENBL_IPC),
        'IPC contacts are enabled, which keep a memory between steps; use <flag ipc="disable"/>',
    ),
    (
        lambda m: m.nhistory > 0,
        "actuators or sensors with a delay keep a history that the state x does not hold; remove their nsample",
    ),
    (
        lambda m: m.nplastic > 0,
        "plastic springs or flexes keep a state that x does not hold; remove springyield and yield",
    ),
    (lambda m: m.npluginstate > 0, "it has a plugin with a state that x does not hold; remove that plugin"),
)


def refuse_unsupported(model: mujoco.MjModel) -> None:
    """Raise ValueError, with reason and remedy, when `model` cannot be optimized here."""
    for is_so, reason in REFUSALS:
        if is_so(model):
            raise ValueError(f"this model is not supported: {reason}")
    _refuse_wrong_numbers(model)
    refuse_callbacks()


def _refuse_wrong_numbers(model: mujoco.MjModel) -> None:
    """Refuse numbers that MuJoCo's compiler lets pass, or that were written into a compiled model."""
    positive("the model's timestep", model.opt.timestep)
    for owner, prefix in ((model, ""), (model.opt, "opt.")):
        for field in dir(owner):
            array = None if field.startswith(_UNFELT) else getattr(owner, field)
            if isinstance(array, np.ndarray) and array.dtype.kind == "f" and np.isnan(array).any():
                at = "".join(f"[{i}]" for i in np.argwhere(np.isnan(array))[0])
                raise ValueError(f"the model must be finite, but {prefix}{field}{at} is nan")
    for i, (low, high) in enumerate(model.actuator_ctrlrange.tolist()):
        if low > high:  # which MuJoCo takes for no limits
            name = model.actuator(i).name or str(i)
            raise ValueError(f"actuator {name!r} must have a ctrlrange from low to high, got {low:g} {high:g}")


def with_converged_solver(model: mujoco.MjModel) -> mujoco.MjModel | None:
    """Copy `model`, with a constraint solver that runs until it has converged; None where there is none to run."""
    from mjslq.dynamics.mujoco.inverse.table.plan import can_be_constrained

    if not can_be_constrained(model):
        return None
    solved = copy.copy(model)
    solved.opt.tolerance, solved.opt.iterations = 0.0, max(model.opt.iterations, _MANY)
    return solved


def massless_joints(model: mujoco.MjModel) -> list[str]:
    """Name the joints that move no mass, a sentence each: any force makes their acceleration too large."""
    sentences = []
    for j in range(model.njnt):
        first = int(model.jnt_dofadr[j])
        last = int(model.jnt_dofadr[j + 1]) if j + 1 < model.njnt else model.nv
        if (model.dof_M0[first:last] < _NO_INERTIA).any():
            name = model.joint(j).name or str(j)
            sentences.append(
                f"joint {name!r} moves no mass: give a link beyond it an inertia, or the joint an armature"
            )
    return sentences


def integrator_named(name: str) -> mujoco.mjtIntegrator:
    """Look up an integrator, upper and lower case alike. Raises ValueError, which lists the names there are."""
    spelled = {known.lower(): known for known in INTEGRATORS}
    lowered = name.lower() if isinstance(name, str) else name
    return INTEGRATORS[choose("integrator", spelled.get(lowered, name), INTEGRATORS)]


def refuse_callbacks() -> None:
    """Raise ValueError when a MuJoCo callback is installed in this process: it would act in every step, unseen."""
    for name in _CALLBACKS:
        if getattr(mujoco, f"get_mjcb_{name}")() is not None:
            raise ValueError(
                f"the MuJoCo callback mjcb_{name} is installed, whose effect on the state cannot be known; "
                f"call mujoco.set_mjcb_{name}(None) first"
            )
