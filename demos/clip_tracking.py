"""A humanoid tracks a clip on a receding horizon, with the Jacobians of this library and with finite differences.

Run with    python demos/clip_tracking.py [servo | motor] [--view]

The G1 (29 joints) follows a recorded squat, wave and step (assets/clips/g1_squat_wave_step.csv): plans of 50 knots of
two simulator steps each, at most 20 iterations a plan, ten knots of each are carried out; twelve bodies are tracked by
frame sensors with pseudo-Huber losses; motors keep to the torques of the robot's description, servos to the joints'
ranges. The usual way to linearize this is one-sided differences: from every knot, a simulation for each of the 70
directions of the state and of the 29 controls, 5070 in all, by `mujoco.rollout`. Here such an engine goes through the
same solver, so that its iterations are measured, too. Both run on one thread; times are CPU time, so that other work
on the machine does not count.
"""

import sys
import time

import mujoco
import mujoco.rollout
import numpy as np

import mjslq
from mjslq.dynamics.dynamics import Linearization
from mjslq.problems.g1_clip import distances, recorded

EPS = 1e-6
COMMITTED = 10


class Differences(mjslq.MujocoDynamics):
    """The engine whose Jacobians are one-sided differences of the step, all simulations in one call."""

    def linearize(self, trajectory):
        """See `mjslq.Dynamics.linearize`."""
        model, space, k = self.model, self.space, self.substeps
        N, ndx, nu, nx = trajectory.horizon, self.ndx, self.nu, self.nx
        X = np.repeat(trajectory.X[:-1, None], 1 + ndx + nu, axis=1)
        U = np.repeat(trajectory.U[:, None], 1 + ndx + nu, axis=1)
        X[:, 1 : 1 + ndx] = space.integrate(X[:, 1 : 1 + ndx], EPS * np.eye(ndx))
        U[:, 1 + ndx :] += EPS * np.eye(nu)
        last = np.vstack([trajectory.X[-1], space.integrate(trajectory.X[-1], EPS * np.eye(ndx))])  # outputs alone
        starts = np.vstack([X.reshape(-1, nx), last])
        controls = np.vstack([U.reshape(-1, nu), np.zeros((len(last), nu))])
        with_time = np.column_stack([np.zeros(len(starts)), starts])
        data = mujoco.MjData(model)
        ends, readings = mujoco.rollout.rollout(model, data, with_time, np.repeat(controls[:, None], k, axis=1))
        F = ends[: -len(last), -1, 1 : 1 + nx].reshape(N, -1, nx)
        Y, Y_last = readings[: -len(last), 0].reshape(N, -1, self.ny), readings[-len(last) :, 0]
        AB = space.difference(F[:, :1], F[:, 1:]).swapaxes(1, 2) / EPS
        C, D = np.empty((N + 1, self.ny, ndx)), np.zeros((N + 1, self.ny, nu))
        CD = (Y[:, 1:] - Y[:, :1]).swapaxes(1, 2) / EPS
        C[:N], D[:N], C[N] = CD[..., :ndx], CD[..., ndx:], (Y_last[1:] - Y_last[0]).T / EPS
        parts = (np.ascontiguousarray(part) for part in (AB[..., :ndx], AB[..., ndx:]))
        return Linearization(*parts, C, D)


def linearization(dynamics, trajectory, repeat):
    """Least CPU time of a linearization. [ms]"""
    dynamics.linearize(trajectory)
    times = []
    for _ in range(repeat):
        begin = time.process_time()
        dynamics.linearize(trajectory)
        times.append(time.process_time() - begin)
    return 1e3 * min(times)


def iterations(problems, repeat=3):
    """Least CPU time of an iteration on each of some problems, by turns from the same start. [ms]"""
    times = [[] for _ in problems]
    for _ in range(repeat):
        for found, problem in zip(times, problems, strict=True):
            begin = time.process_time()
            result = mjslq.solve(problem, max_iterations=5, tol=0.0)
            found.append((time.process_time() - begin) / result.iterations)
    return [1e3 * min(found) for found in times]


class Timed(mjslq.MPC):
    """A controller that adds up the iterations of its plans and their CPU time. [s]"""

    iterations, spent = 0, 0.0

    def step(self, x, t, **options):
        """See `mjslq.MPC.step`."""
        plans, begin = self.statistics.plans, time.process_time()
        u = super().step(x, t, **options)
        if self.statistics.plans > plans:
            self.spent += time.process_time() - begin
            self.iterations += self.plan.iterations
        return u


def main(drive="servo", view=False):
    clip, made = recorded(), mjslq.problems.get("g1_clip", drive=drive)
    model = made.dynamics.model
    ours = mjslq.MujocoDynamics.from_model(model, substeps=2, threads=1)
    theirs = Differences.from_model(model, substeps=2, threads=1)
    plan = mjslq.solve(made.on(ours), max_iterations=20).trajectory  # compiles what is not compiled yet
    A, B = ours.linearize(plan).A, theirs.linearize(plan).A
    error = np.median(np.abs(A - B).max(axis=(1, 2)) / np.abs(A).max(axis=(1, 2)))
    print(f"{drive}s; the two engines' A differ by {error:.1e} of its largest entry (median of the knots)")
    times = [linearization(ours, plan, 20), linearization(theirs, plan, 3)]
    print(f"a linearization: {times[0]:.1f} ms here, {times[1]:.0f} ms by differences: {times[1] / times[0]:.1f} times")
    times = iterations([made.on(engine) for engine in (ours, theirs)])
    print(f"an iteration: {times[0]:.1f} ms here, {times[1]:.0f} ms with differences: {times[1] / times[0]:.1f} times")
    costs, loops = [], []
    for name, engine in (("here", ours), ("differences", theirs)):
        problem = made.on(engine)
        mpc = Timed(problem, iterations=20, replan_every=COMMITTED)
        run, statistics = mpc.run(duration=clip.duration).trajectory, mpc.statistics
        loops.append(engine.rollout(run.X[0], run.U))  # with what the sensors read
        away = 1e3 * distances(loops[-1], problem.costs, engine)
        costs.append(1e3 * mpc.spent / mpc.iterations)
        print(
            f"{name}: {statistics.plans} plans, {statistics.failed} failed, {mpc.iterations} iterations, "
            f"{mpc.spent:.1f} s; bodies {away.mean():.1f} mm from the clip's on average, {away.max():.0f} at most"
        )
    ratio = costs[1] / costs[0]
    print(f"an iteration of these: {costs[0]:.1f} ms here, {costs[1]:.0f} ms with differences: {ratio:.1f} times")
    if view:
        whole = mjslq.problems.get("g1_clip", drive=drive, horizon=loops[0].horizon)
        mjslq.view(mjslq.solve(whole, guess=loops[0], max_iterations=1))


if __name__ == "__main__":
    main(*[word for word in sys.argv[1:] if word != "--view"], view="--view" in sys.argv)
