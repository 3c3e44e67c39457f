"""A humanoid tracks a clip: what a linearization and an iteration cost here, and by finite differences.

Run with    python demos/clip_tracking.py

The G1 (29 joints) follows a squat with waving arms: 50 knots of two simulator steps, twelve bodies tracked by frame
sensors. The usual way to linearize this is one-sided differences of the step: from every knot, a simulation for each of
the 70 directions of the state and of the 29 controls, about 5000 in all, by `mujoco.rollout`. Both run on one thread;
times are CPU time, so that other work on the machine does not count.
"""

import time

import mujoco
import mujoco.rollout
import numpy as np

import mjslq

EPS = 1e-6


def milliseconds(call, repeat=5):
    """Least CPU time of a call. [ms]"""
    call()
    times = []
    for _ in range(repeat):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return 1e3 * min(times)


def differences(dynamics, trajectory):
    """A, B, C, D by one-sided differences of the step: all simulations in one call."""
    model, data, space = dynamics.model, mujoco.MjData(dynamics.model), dynamics.space
    N, ndx, nu, k = trajectory.horizon, dynamics.ndx, dynamics.nu, dynamics.substeps
    X = np.repeat(trajectory.X[:-1], 1 + ndx + nu, axis=0).reshape(N, -1, dynamics.nx)
    U = np.repeat(trajectory.U, 1 + ndx + nu, axis=0).reshape(N, -1, nu)
    X[:, 1 : 1 + ndx] = space.integrate(X[:, 1 : 1 + ndx], EPS * np.eye(ndx))
    U[:, 1 + ndx :] += EPS * np.eye(nu)
    X, U = X.reshape(-1, dynamics.nx), U.reshape(-1, nu)
    starts = np.column_stack([np.zeros(len(X)), X])  # time, qpos, qvel
    ends, readings = mujoco.rollout.rollout(model, data, starts, np.repeat(U[:, None], k, axis=1))
    ends = ends[:, -1, 1 : 1 + dynamics.nx].reshape(N, -1, dynamics.nx)
    Y = readings[:, 0].reshape(N, -1, dynamics.ny)
    AB = space.difference(ends[:, :1], ends[:, 1:]).swapaxes(1, 2) / EPS
    CD = (Y[:, 1:] - Y[:, :1]).swapaxes(1, 2) / EPS
    return AB[..., :ndx], AB[..., ndx:], CD[..., :ndx], CD[..., ndx:]


def main() -> None:
    made = mjslq.problems.get("g1_clip")
    dynamics = mjslq.MujocoDynamics.from_model(made.dynamics.model, substeps=2, threads=1)
    problem = made.on(dynamics)
    result = mjslq.solve(problem, max_iterations=20)
    plan = result.trajectory
    print(f"{result.iterations} iterations, {result.status.value}; {problem.describe(plan)['bodies']}")
    ours, theirs = dynamics.linearize(plan), differences(dynamics, plan)
    error = np.median(np.abs(ours.A - theirs[0]).max(axis=(1, 2)) / np.abs(ours.A).max(axis=(1, 2)))
    print(f"median difference of A between the two, relative to its largest entry: {error:.1e}")
    linearize, by_differences = (
        milliseconds(lambda: dynamics.linearize(plan)),
        milliseconds(lambda: differences(dynamics, plan), 2),
    )
    ratio = by_differences / linearize
    print(f"linearization: {linearize:.1f} ms here, {by_differences:.0f} ms by differences, {ratio:.0f} times as long")
    begin = time.process_time()
    again = mjslq.solve(problem, max_iterations=5, tol=0.0)
    iteration = 1e3 * (time.process_time() - begin) / 6  # five steps, six linearizations
    other = iteration - linearize + by_differences
    print(f"iteration: {iteration:.1f} ms here, {other:.0f} ms with differences, {other / iteration:.0f} times as long")
    assert again.iterations == 5
    mjslq.view(result)


if __name__ == "__main__":
    main()
