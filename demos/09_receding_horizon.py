"""Three robots under receding-horizon control, on plants that are not quite their models, pushed on the way.

Run with    python demos/09_receding_horizon.py [picture.png]

Each plan has 50 knots and one iteration, or three for the swing-up. Printed are the times of the plans beside the
control period; the picture shows how far each robot is from its task, and when it is pushed.
"""

import copy
import dataclasses
import sys

import mujoco
import numpy as np

import mjslq
from mjslq.simulation import Kick, Push


def heavier(problem, body, factor):
    """The problem's model with another mass of one body."""
    model = copy.copy(problem.dynamics.model)
    model.body(body).mass *= factor
    model.body(body).inertia *= factor
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def cart_pole():
    problem = mjslq.problems.get("cart_pole", horizon=50, duration=2.0, running=10.0)
    loop = mjslq.MPC(problem, iterations=3).run(
        heavier(problem, "pole", 1.1), 7.0, disturbances=[Kick([0.0, 0.0, 0.0, 0.8], 4.0)]
    )
    return "cart-pole: angle from upright [rad]", 4.0, loop, np.abs(loop.trajectory.X[:, 1])


def panda():
    made = mjslq.problems.get("panda_reach", horizon=50, duration=0.5, limits=True)
    target = np.array([0.4, 0.3, 0.5])
    costs = [
        mjslq.costs.State(np.r_[np.zeros(7), np.full(7, 0.1)], made.x0),
        mjslq.costs.Control(1e-4),
        mjslq.costs.Sensor("panda_hand_tcp", target, 1e3, "always"),
    ]
    problem = mjslq.Problem(made.dynamics, 50, made.x0, costs, U0=made.U0)
    push = Push("panda_link5", [0.0, 60.0, 0.0], 1.0, 0.1)
    loop = mjslq.MPC(problem, delay=0.01).run(None, 2.0, disturbances=[push])
    hands = [problem.dynamics.step(x, np.zeros(7))[1] for x in loop.trajectory.X]
    return "Panda: hand from its target [m]", 1.0, loop, np.linalg.norm(np.array(hands) - target, axis=1)


def solo12():
    made = mjslq.problems.get("solo12_stand", horizon=50)
    problem = dataclasses.replace(made, bounds=mjslq.Bounds(u=(-2.7, 2.7)))
    plant = heavier(problem, "base_link", 1.1)
    plant.geom_friction[:, 0] *= 0.8
    push = Push("base_link", [15.0, 7.0, 0.0], 1.0, 0.1)
    loop = mjslq.MPC(problem, first_iterations=30).run(plant, 2.0, disturbances=[push])
    stand = made.costs[0].target
    return "Solo12: base from its place [m]", 1.0, loop, np.linalg.norm(loop.trajectory.X[:, :3] - stand[:3], axis=1)


def main() -> None:
    shown = [robot() for robot in (cart_pole, panda, solo12)]
    for title, _, loop, distance in shown:
        period = 1e3 * float(loop.trajectory.dt[0])
        print(f"{title.split(':')[0]:10} period {period:.0f} ms; {loop.statistics}; in the end {distance[-1]:.4f}")
    if len(sys.argv) > 1:
        from mjslq.reports import figures

        @figures.styled
        def draw():
            figure, axes = figures.subplots(1, 3, (11.0, 3.4))
            for axis, (title, pushed, loop, distance) in zip(axes[0], shown, strict=True):
                axis.semilogy(loop.trajectory.times, np.maximum(distance, 1e-5))
                axis.axvline(pushed, color=figures.COLORS[1], linewidth=1.0)
                axis.set(title=title, xlabel="time [s]")
            figures.save(figure, sys.argv[1])

        draw()


if __name__ == "__main__":
    main()
