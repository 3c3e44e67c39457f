"""A policy in a plain MuJoCo loop, with NumPy alone: it is pushed, and the robot is not quite the model.

Run with    python demos/11_policy_elsewhere.py [picture.png]
"""

import copy
import sys

import mujoco
import numpy as np

import mjslq


def control(policy, model, data, feedback=True):
    """The control in the state of `data`: everything that a robot's computer has to do."""
    n = min(int(data.time / policy["dt"][0] + 1e-6), len(policy["U"]) - 1)
    q, v = policy["X"][n, : model.nq], policy["X"][n, model.nq :]
    dq = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, dq, 1.0, q, data.qpos)  # plain differences, but for quaternions
    u = policy["U"][n]
    if feedback:
        u = u - policy["K"][n] @ np.concatenate([dq, data.qvel - v])
    return np.clip(u, policy["lower"][n], policy["upper"][n])


def run(policy, model, push, feedback):
    """Angle of the pole from upright [rad] at each step; `push` [N] acts on it from 0.5 to 0.6 s."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = policy["X"][0, : model.nq], policy["X"][0, model.nq :]
    angles = []
    for _ in range(len(policy["U"])):
        data.ctrl[:] = control(policy, model, data, feedback)
        data.xfrc_applied[model.body("pole").id, 0] = push if 0.5 <= data.time < 0.6 else 0.0
        mujoco.mj_step(model, data)
        angles.append(data.qpos[model.joint("hinge").qposadr[0]])
    return np.array(angles)


def main() -> None:
    problem = mjslq.problems.get("cart_pole", limit=20.0, running=1.0)
    result = mjslq.solve(problem)
    result.policy.save("policy.npz")

    # From here on there is no mjslq: a file of arrays, a model, and MuJoCo's own loop.
    policy, model = np.load("policy.npz"), problem.dynamics.model
    policy = {name: policy[name] for name in ("X", "U", "K", "dt", "lower", "upper")}
    heavier = copy.copy(model)
    heavier.body("pole").mass *= 1.3
    heavier.body("pole").inertia *= 1.3
    mujoco.mj_setConst(heavier, mujoco.MjData(heavier))
    cases = {"undisturbed": (model, 0.0), "pushed by 2 N": (model, 2.0), "pole heavier by 30 %": (heavier, 0.0)}
    curves = {
        name: [run(policy, plant, push, feedback) for feedback in (True, False)]
        for name, (plant, push) in cases.items()
    }
    for name, (closed, opened) in curves.items():
        print(f"{name:22} ends {closed[-1]:+.3f} rad from upright with feedback, {opened[-1]:+.3f} without")
    if len(sys.argv) > 1:
        draw(curves, policy["dt"][0], sys.argv[1])
    mjslq.view(result)


def draw(curves, dt, file):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 3.0), layout="constrained")
    for axis, (name, (closed, opened)) in zip(figure.subplots(1, 3, sharey=True), curves.items(), strict=True):
        times = dt * np.arange(1, len(closed) + 1)
        axis.plot(times, opened, color="#d6592b", label="controls alone")
        axis.plot(times, closed, color="#2f6fb3", label="with feedback")
        axis.set(title=name, xlabel="time [s]")
    figure.axes[0].set_ylabel("angle of the pole from upright [rad]")
    figure.axes[0].legend()
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
