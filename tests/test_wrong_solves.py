"""Wrong calls: solves, policies, receding horizons and batches that are asked for what cannot be."""

import io
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from wrong_inputs import MODEL, one_sentence, pose, pose_arm, refused, swing, table

import mjslq
from mjslq import MPC, Bounds, FunctionDynamics, Policy, Status, Trajectory, constraints, simulation, solve, starts

nan, inf = float("nan"), float("inf")
PROBLEM = pose(x0=[0.1, 0.0])
HELD = pose(constraints=[constraints.State(-1, 1)])
WRONG = FunctionDynamics(swing, 2, 1, 0.05, jacobian=lambda x, u, t: (np.zeros((2, 2)), np.ones((2, 1))))


def solving(*given, **options):
    return lambda: solve(*(given or (PROBLEM,)), **options)


def policy(X=(3, 2), U=(2, 1), **options):
    return lambda: Policy(np.zeros(X), np.zeros(U), **options)


@table(
    ("problem name", solving("hopper"), "problem must be a mjslq.Problem, got str 'hopper'"),
    ("problem none", solving(None), "problem must be a mjslq.Problem, got NoneType"),
    ("method", solving(PROBLEM, "slk"), "unknown method 'slk'; there are: auto, slq", "did you mean 'slq'?"),
    ("method none", solving(PROBLEM, None), "unknown method None; there are: "),
    ("option", solving(max_iteration=3), "'max_iteration'; there are: ", "did you mean 'max_iterations'?"),
    ("option of another", solving(PROBLEM, "slq", radius=1.0), "unknown option for method 'slq' 'radius'"),
    ("tol negative", solving(tol=-1), "tol must be a number of at least 0, got -1"),
    ("tol nan", solving(tol=nan), "tol must be a number of at least 0, got nan"),
    ("tol text", solving(tol="small"), "tol must be a number of at least 0, got 'small'"),
    ("iterations float", solving(max_iterations=2.5), "max_iterations must be a whole number of at least 0, got 2.5"),
    ("iterations negative", solving(max_iterations=-1), "max_iterations must be a whole number"),
    ("deadline", solving(deadline=0), "deadline must be positive and finite, got 0"),
    ("preset", solving(PROBLEM, "slq", preset="bobrow"), "there are: sideris-bobrow"),
    ("guess text", solving(guess="hold"), "guess must be a Result, a Trajectory, a Policy or an array", "'hold'"),
    ("guess function", solving(guess=swing), "guess must be a Result, a Trajectory", "got function"),
    ("guess shape", solving(guess=np.zeros((4, 4))), "controls (10, 1) or states (11, 2), got shape (4, 4)"),
    ("guess nan", solving(guess=np.full((10, 1), nan)), "guess must be finite"),
    ("guess of another system", solving(guess=Policy(np.zeros((11, 3)), np.zeros((10, 1)))), "3 states", "has 2 and 1"),
    ("guess of another horizon", solving(guess=Trajectory(np.zeros((6, 2)), np.zeros((5, 1)))), "5 steps", "has 10"),
    ("two guesses", solving(guess=np.zeros((10, 1)), U0=np.zeros((10, 1))), "either guess or U0 and X0, not both"),
    ("U0 shape", solving(U0=np.zeros((9, 1))), "U0 must have shape (10, 1) or (1,), got (9, 1)"),
    ("U0 inf", solving(U0=np.full((10, 1), inf)), "U0 must be finite"),
    ("X0 shape", solving(X0=np.zeros((10, 2))), "X0 must have shape (11, 2), got (10, 2)"),
    ("X0 for another method", solving(PROBLEM, "gradient", X0=np.zeros((11, 2))), "takes no state guess X0; these do"),
    ("X0 with constraints", solving(HELD, X0=np.zeros((11, 2))), "a problem with constraints takes no state guess"),
    ("verbose text", solving(verbose="yes"), "verbose must be a whole number of at least 0, got str 'yes'"),
    ("callback text", solving(callback="print"), "callback must be a function, got str 'print'"),
    ("stream text", solving(stream="log.txt"), "stream must be a file that is open for writing, got str"),
    ("flag text", solving(check_derivatives="yes"), "check_derivatives must be True or False, got str 'yes'"),
    ("flag number", solving(keep_iterates=1), "keep_iterates must be True or False, got int 1"),
    ("wrong derivatives", solving(pose(dynamics=WRONG), check_derivatives=True), "derivative check: A is off"),
    ("constraints", solving(HELD, "slq"), "method 'slq' takes no constraints", "'state'", "these do: auto"),
    ("equality", solving(pose(constraints=[constraints.Terminal(lambda x: x)]), "pronto"), "no equality constraints"),
    ("free start", solving(pose(constraints=[constraints.Initial(free=0)]), "newton"), "takes no free initial state"),
    ("gains", solving(PROBLEM, "pronto", gains=np.zeros((3, 1, 2))), "gains must have shape (10, 1, 2), got (3, 1, 2)"),
    ("regulator", solving(PROBLEM, "pronto", regulator=(1, 0)), "R must be positive definite"),
    ("radius", solving(PROBLEM, "trust-region", radius=0), "radius must be positive and finite, got 0"),
    ("eta", solving(PROBLEM, "trust-region", eta=(1, 0)), "0 < eta_1 < eta_2 < 1, got (1, 0)"),
    ("weights", solving(HELD, "square-root-sweep", weights=(1.0, 2.0)), "one number a control, 1, got 2"),
    ("first", solving(HELD, "square-root-sweep", first=("x",)), "there are: state, controls"),
    ("hold", lambda: starts.hold("hopper"), "problem must be a mjslq.Problem, got str"),
    ("hold x", lambda: starts.hold(PROBLEM, [0.0]), "x must have shape (2,), got (1,)"),
    ("servo target", lambda: starts.servo(PROBLEM, [0.0]), "target must have shape (2,), got (1,)"),
    ("servo stiffness", lambda: starts.servo(pose_arm(), stiffness=-1), "stiffness must be positive and finite"),
    ("explain", lambda: mjslq.explain("x"), "result must be a mjslq.Result, got str 'x'"),
    ("explain problem", lambda: mjslq.explain(solve(PROBLEM), "x"), "problem must be a mjslq.Problem, got str 'x'"),
    ("explain another", lambda: mjslq.explain(solve(PROBLEM), pose(horizon=5)), "has 5 steps", "but the result 10"),
    ("replay", lambda: solve(PROBLEM).replay(), "only results of MuJoCo models can be replayed"),
    ("export", lambda: mjslq.export_html(None, "x.html"), "only a Result", "got NoneType"),
    ("view", lambda: mjslq.view(3, block=False), "a viewer shows a Result", "got int"),
    ("port 0", lambda: mjslq.view(solve(PROBLEM), port=0, block=False), "port must be a whole number of at least 1"),
    ("port high", lambda: mjslq.view(solve(PROBLEM), port=70000, block=False), "port must be at most 65535, got 70000"),
    ("host", lambda: mjslq.view(solve(PROBLEM), host="256.1.1.1", block=False), "cannot listen at '256.1.1.1'"),
)  # fmt: skip
def test_solves(call, fragments):
    refused(call, *fragments)


@table(
    ("X", policy(X=3), "X must have shape (N + 1, nx), got (3,)"),
    ("U", policy(U=(3, 1)), "U must have shape (2, nu), got (3, 1)"),
    ("no step", policy(X=(1, 2), U=(0, 1)), "X must have at least two knots", "got 1"),
    ("no knot", policy(X=(0, 2), U=(0, 1)), "X must have at least two knots", "got 0"),
    ("K", policy(K=np.zeros((2, 1, 3))), "K must have shape (2, 1, 2), got (2, 1, 3)"),
    ("dt", policy(dt=0), "dt must be positive, got 0"),
    ("dt of three", policy(dt=[1, 2, 3]), "dt must be a number or one per step (2,), got shape (3,)"),
    ("limits", policy(lower=2, upper=1), "lower must not lie above upper"),
    ("space", policy(space="SE3"), "space must be the state space of an engine, got str 'SE3'"),
    ("space of another", policy(space=MODEL.space.plain(5)), "space has states of 5 entries, but X those of 2"),
    ("x", lambda: policy()()([0.0], 0.0), "x must have shape (2,), got (1,)"),
    ("x nan", lambda: policy()()([0.0, nan], 0.0), "x must be finite"),
    ("t text", lambda: policy()()([0.0, 0.0], "now"), "t must be an array of numbers, got str 'now'"),
    ("t nan", lambda: policy()()([0.0, 0.0], nan), "t must be a time, got nan"),
    ("t none", lambda: policy()()([0.0, 0.0], None), "t must be a time"),
    ("shifted", lambda: policy()().shifted(-1), "steps must be a whole number of at least 0, got int -1"),
    ("along", lambda: Policy.along("x"), "trajectory must be a Trajectory, got str 'x'"),
    ("trajectory empty", lambda: Trajectory(np.zeros((0, 2)), np.zeros((0, 1))), "X must have at least one knot"),
    ("diverged beyond", lambda: Trajectory(np.zeros((3, 2)), np.zeros((2, 1)), diverged_at=9), "knots 0 to 2, got 9"),
    ("diverged text", lambda: Trajectory(np.zeros((3, 2)), np.zeros((2, 1)), diverged_at="x"), "a whole number"),
)  # fmt: skip
def test_policies_and_trajectories(call, fragments):
    refused(call, *fragments)


def mpc(problem=PROBLEM, **options):
    return lambda: MPC(problem, **options)


def running(problem=PROBLEM, **options):
    return lambda: MPC(problem).run(**options)


@table(
    ("problem", mpc("hopper"), "problem must be a mjslq.Problem, got str"),
    ("method", mpc(method="slk"), "unknown method 'slk'"),
    ("iterations", mpc(iterations=0), "iterations must be a whole number of at least 1, got int 0"),
    ("period", mpc(period=0), "period must be positive and finite, got 0"),
    ("delay", mpc(delay=-1), "delay must be at least 0, got -1"),
    ("replan", mpc(replan_every=0), "replan_every must be a whole number of at least 1"),
    ("deadline", mpc(deadline=-1), "deadline must be positive and finite, got -1"),
    ("option", mpc(radius=1), "'radius'; there are: "),
    ("option value", mpc(tol=-1), "tol must be a number of at least 0, got -1"),
    ("uneven", mpc(pose(dynamics=FunctionDynamics(swing, 2, 1, [0.1, 0.2]), horizon=2)), "steps of equal length"),
    ("x", lambda: MPC(PROBLEM).step([0.0], 0.0), "x must have shape (2,), got (1,)"),
    ("x nan", lambda: MPC(PROBLEM).step([0.0, nan], 0.0), "x must be finite, but x[1] is nan"),
    ("t nan", lambda: MPC(PROBLEM).step([0.0, 0.0], nan), "t must be finite"),
    ("t text", lambda: MPC(PROBLEM).step([0.0, 0.0], "now"), "t must be an array of numbers"),
    ("no plan", lambda: MPC(PROBLEM).plan, "there is no plan yet: call step first"),
    ("pose", lambda: MPC(PROBLEM).pose(pose(horizon=5)), "the problem has 5 steps", "the controller 10"),
    ("blown up", lambda: MPC(pose(dynamics=FunctionDynamics(lambda x, u: x * 1e200, 2, 1, 0.1))).step([1, 1], 0.0),
     "the first plan failed, so there is no control"),
    ("plant", running(plant="robot"), "plant must be a mujoco.MjModel or an engine, got str"),
    ("plant of another", running(plant=MODEL, problem=pose(x0=[0, 0, 0], dynamics=FunctionDynamics(
        lambda x, u: x, 3, 1, 0.02))), "the plant has 2 states and 1 controls, but the problem has 3 and 1"),
    ("duration", running(duration=0), "duration must be positive and finite, got 0"),
    ("duration between", running(duration=0.07), "must be a whole number of steps of 0.05 s"),
    ("x0", running(x0=[0.0]), "x0 must have shape (2,), got (1,)"),
    ("disturbances", running(disturbances=None), "disturbances must be a list of Push and Kick, got NoneType"),
    ("disturbance", running(disturbances=["push"]), "disturbances[0] must be a Push or a Kick, got str"),
    ("kick", running(disturbances=[simulation.Kick([1, 0, 0], 0)]), "disturbances[0].dx must have shape (2,)"),
    ("push", running(disturbances=[simulation.Push("arm", [1, 0, 0], 0)]), "which only MuJoCo plants have"),
    ("body", running(pose_arm(), disturbances=[simulation.Push("amr", [1, 0, 0], 0)]), "unknown body 'amr'", "'arm'?"),
)  # fmt: skip
def test_receding_horizons(call, fragments):
    refused(call, *fragments)


def many(problems=(PROBLEM,), *given, **options):
    return lambda: list(mjslq.solve_many(problems, *given, **options))


@table(
    ("one", many(PROBLEM), "problems must be several, such as a list; for one there is mjslq.solve"),
    ("none", many(None), "problems must be several mjslq.Problem, such as a list, got NoneType None"),
    ("name", many("hopper"), "problems must be several", "got str 'hopper'"),
    ("executor", many([PROBLEM], "threads"), "executor must be a concurrent.futures.Executor, got str"),
    ("workers", many(workers=0), "workers must be a whole number of at least 1, got int 0"),
    ("in flight", many(in_flight=0), "in_flight must be a whole number of at least 1"),
    ("method", many(method="slk"), "unknown method 'slk'; there are: "),
    ("option", many(radius=2), "'radius'; there are: "),
    ("option value", many(tol=-1), "tol must be a number of at least 0, got -1"),
    ("folder is a file", many(out=__file__), "cannot write to ", "File exists"),
)
def test_many_problems(call, fragments):
    refused(call, *fragments)


def test_problems_that_are_none_are_records_and_take_nobody_along():
    with ThreadPoolExecutor(1) as pool:
        wrong, right = mjslq.solve_many(["hopper", PROBLEM], pool, ordered=True)
    one_sentence(wrong.error, "problem must be a mjslq.Problem, got str 'hopper'")
    assert right.success


def test_a_generator_that_raises_loses_nothing_of_what_is_under_way():
    def problems():
        yield PROBLEM
        yield PROBLEM
        raise RuntimeError("no more problems")

    found = []
    with ThreadPoolExecutor(1) as pool, pytest.raises(RuntimeError, match="no more problems"):
        for solved in mjslq.solve_many(problems(), pool):
            found.append(solved)
    assert [solved.success for solved in found] == [True, True]


class Full(io.StringIO):
    """A disk that is full after some lines."""

    def __init__(self, lines):
        super().__init__()
        self.left = lines

    def write(self, text):
        self.left -= text.count("\n")
        if self.left < 0:
            raise OSError(28, "No space left on device")
        return super().write(text)


@pytest.mark.parametrize("lines", [0, 1, 2])
def test_a_stream_that_fails_ends_the_printing_and_not_the_solve(lines):
    result = solve(PROBLEM, verbose=1, stream=Full(lines))
    assert result.success and result.cost == solve(PROBLEM).cost


def test_a_stream_that_is_closed_loses_no_result():
    stream = io.StringIO()
    stream.close()
    assert solve(PROBLEM, verbose=1, stream=stream).success


@table(
    ("raises", lambda entry: 1 / 0, "ZeroDivisionError: division by zero"),
    ("takes nothing", lambda: None, "takes 0 positional arguments but 1 was given"),
)
def test_callbacks_that_fail_keep_the_best_iterate(call, fragments):
    result = solve(PROBLEM, callback=call)
    assert result.status is Status.FAILED and result.cost == PROBLEM.cost(result.trajectory)
    one_sentence(result.message, "this is the best iterate so far", *fragments)


def test_bounds_without_room_for_the_model_are_no_silent_ones():
    refused(lambda: pose_arm(bounds=Bounds(u=(3, 2))), "lower limit of control 'm'", "got 3 and 2")
