"""What the kernel has to know of forces along lengths that are no linear function of positions (`arms`)."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.forces.unmodelled_forces import (
    UnmodelledForces,
    coupled_dofs,
    driven_dofs,
    touched_dofs,
)
from mjslq.dynamics.mujoco.inverse.table.plan import TRN, WRAP, tendons


def arm_table(model: mujoco.MjModel, rest: UnmodelledForces) -> dict[str, Any]:
    """Tendon, or output and control, of each arm; its dofs, and which of them lie on one branch."""
    found = [(int(t), -1, -1, sorted(touched_dofs(model, int(t)))) for t in np.flatnonzero(rest.moving_arm_tendons)]
    for i in np.flatnonzero(rest.moving_arm_actuators):
        out, control = int(model.actuator_outadr[i]), int(model.actuator_ctrladr[i])
        found.append((-1, out, control, sorted(driven_dofs(model, int(i)))))
    sizes, prm = [len(dofs) for *_, dofs in found], tendons(model)["ten_prm"]
    branches = [_branches(model, dofs) for *_, dofs in found]
    moved: set[int] = set()
    pieces, straight = [], []
    for k, (tendon, out, _, dofs) in enumerate(found):
        path = _straight_pieces(model, tendon, out)
        straight.append(path is not None)
        pieces += [(k, *piece) for piece in path or ()]
        moved |= set(dofs) if path is None else set()
    arms = np.full(model.nu, -1)
    for k, (tendon, _, control, _) in enumerate(found):
        if tendon < 0:
            arms[control] = k
    return {
        "narm": len(found), "narm_dof": sum(sizes), "narm_square": sum(size**2 for size in sizes),
        "narm_q": len(moved), "arm_q": np.array(sorted(moved), np.int64),
        "arms_act": int(rest.moving_arm_actuators.any()),
        "arm_prm": prm[[max(tendon, 0) for tendon, *_ in found]] if len(prm) else prm,
        "arm_straight": np.array(straight, np.int64), "npiece": len(pieces),
        "piece_arm": np.array([piece[0] for piece in pieces], np.int64),
        "piece_from": np.array([piece[1] for piece in pieces], np.int64),
        "piece_to": np.array([piece[2] for piece in pieces], np.int64),
        "piece_share": np.array([piece[3] for piece in pieces], float),
        "arm_tendon": np.array([tendon for tendon, *_ in found], np.int64),
        "arm_out": np.array([out for _, out, *_ in found], np.int64),
        "arm_row": np.array([control for _, _, control, _ in found], np.int64), "act_arm": arms,
        "arm_first": np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        "arm_dof": np.array([dof for *_, dofs in found for dof in dofs], np.int64),
        "arm_at": np.concatenate([[0], np.cumsum(np.square(sizes))])[:-1].astype(np.int64),
        "arm_branch": np.concatenate([np.zeros(0), *branches]).astype(np.int64),
    }  # fmt: skip


def _straight_pieces(model: mujoco.MjModel, tendon: int, out: int) -> list[tuple[int, int, float]] | None:
    """Pieces (from site, to site, share) of a tendon that is straight between sites; None for other arms."""
    share = 1.0
    if tendon < 0:
        i = int(np.flatnonzero(model.actuator_outadr == out)[0])
        if model.actuator_trntype[i] != TRN.mjTRN_TENDON:
            return None
        tendon, share = int(model.actuator_trnid[i, 0]), float(model.actuator_gear[out, 0])
    found, last, divisor = [], -1, 1.0
    for k in range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon]):
        kind, of = model.wrap_type[k], int(model.wrap_objid[k])
        if kind in (WRAP.mjWRAP_SPHERE, WRAP.mjWRAP_CYLINDER):
            return None
        if kind == WRAP.mjWRAP_PULLEY:
            last, divisor = -1, float(model.wrap_prm[k])
        elif kind == WRAP.mjWRAP_SITE:
            if last >= 0 and model.site_bodyid[last] != model.site_bodyid[of]:
                found.append((last, of, share / divisor))
            last = of
    return found


def _branches(model: mujoco.MjModel, dofs: list[int]) -> Any:
    """Whether each two of `dofs` lie on one branch, flattened."""
    above = [coupled_dofs(model, i) for i in dofs]
    pairs = [(i in of_j or j in of_i) for i, of_i in zip(dofs, above) for j, of_j in zip(dofs, above)]  # noqa: B905
    return np.array(pairs, np.int64)
