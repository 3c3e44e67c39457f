"""Wrong problems: sizes, starts, costs, limits and constraints that do not fit end in one sentence each."""

import numpy as np
from wrong_inputs import MODEL, PENDULUM, pose, pose_arm, refused, table

from mjslq import Bounds, Problem, Status, constraints, costs, solve

nan, inf = float("nan"), float("inf")
NUMBERS = "must be an array of numbers"


def state(**options):
    return pose(costs.State(1.0, **options))


def limited(**options):
    return pose(bounds=Bounds(**options))


def held(*given, **options):
    return pose(constraints=list(given), **options)


def residual(r, **options):
    return pose(costs.Residual(r, **options))


def raising(x, u, t):
    raise KeyError("hand")


@table(
    ("no engine", lambda: pose(dynamics="hopper"), "dynamics must be an engine", "got str"),
    ("horizon 0", lambda: pose(horizon=0), "horizon must be a whole number of at least 1", "got int 0"),
    ("horizon below 0", lambda: pose(horizon=-3), "horizon must be a whole number", "-3"),
    ("horizon float", lambda: pose(horizon=2.0), "horizon must be a whole number", "got float 2.0"),
    ("horizon nan", lambda: pose(horizon=nan), "horizon must be a whole number", "got float nan"),
    ("horizon text", lambda: pose(horizon="10"), "horizon must be a whole number", "got str '10'"),
    ("horizon bool", lambda: pose(horizon=True), "horizon must be a whole number", "got bool True"),
    ("horizon huge", lambda: pose(horizon=10**12), "horizon must be at most 10000000 steps"),
    ("x0 short", lambda: pose(x0=[0.0]), "x0 must have shape (2,)", "got (1,)"),
    ("x0 nan", lambda: pose(x0=[0.0, nan]), "x0 must be finite", "x0[1] is nan"),
    ("x0 text", lambda: pose(x0="home"), "x0 " + NUMBERS, "got str 'home'"),
    ("x0 texts of numbers", lambda: pose(x0=["0", "1"]), "x0 " + NUMBERS, "got list"),
    ("x0 none", lambda: pose(x0=None), "x0 must have shape (2,)"),
    ("x0 ragged", lambda: pose(x0=[[1], [1, 2]]), "x0 " + NUMBERS),
    ("x0 complex", lambda: pose(x0=[1j, 0]), "x0 " + NUMBERS),
    ("no costs", lambda: Problem(PENDULUM, 10, [0, 0], []), "costs must name at least one term"),
    ("costs none", lambda: Problem(PENDULUM, 10, [0, 0], None), "costs must be a list", "got NoneType"),
    ("costs by name", lambda: Problem(PENDULUM, 10, [0, 0], {"a": costs.Control(1.0)}), "costs must be a list", "dict"),
    ("cost is a class", lambda: pose(costs.State), "costs[1] must be a term of mjslq.costs"),
    ("cost is a function", lambda: pose(lambda x, u: 0.0), "costs[1] must be a term", "got function"),
    ("cost is a constraint", lambda: pose(constraints.State(0.0)), "costs[1] must be a term", "got State"),
    ("constraint is a cost", lambda: held(costs.Control(1.0)), "constraints[0] must be one of mjslq.constraints"),
    ("constraints none", lambda: pose(constraints=None), "constraints must be a list", "got NoneType"),
    ("constraints text", lambda: pose(constraints="x < 1"), "constraints[0] must be one of", "got str"),
    ("bounds pair", lambda: pose(bounds=(-1, 1)), "bounds must be mjslq.Bounds", "got tuple"),
    ("U0 shape", lambda: pose(U0=np.zeros((9, 1))), "U0 must have shape (1,) or (10, 1)", "got (9, 1)"),
    ("U0 nan", lambda: pose(U0=[nan]), "U0 must be finite"),
    ("options unknown", lambda: pose(options={"tolerance": 1}), "unknown option 'tolerance'; there are: "),
    ("options value", lambda: pose(options={"max_iterations": 1.5}), "max_iterations must be a whole number"),
    ("options list", lambda: pose(options=["tol"]), "options must be a table of values by name", "got list"),
    ("parameters none", lambda: pose(parameters=None), "parameters must be a table", "got NoneType"),
    ("name number", lambda: pose(name=3), "name must be a text", "got int 3"),
    ("describe text", lambda: pose(describe="x"), "describe must be a function", "got str 'x'"),
    ("drawing text", lambda: pose(drawing="x"), "drawing must be a mjslq.Scene", "got str 'x'"),
)  # fmt: skip
def test_problems(call, fragments):
    refused(call, *fragments)


@table(
    ("weight negative", lambda: pose(costs.State(-1.0)), "weight must be positive semidefinite", "eigenvalue -1"),
    ("weight nan", lambda: pose(costs.Control(nan)), "costs[1] (Control): weight must be finite"),
    ("weight inf", lambda: pose(costs.State(inf)), "weight must be finite", "inf"),
    ("weight text", lambda: pose(costs.State("high")), "weight " + NUMBERS, "got str 'high'"),
    ("weight shape", lambda: pose(costs.State([1, 2, 3])), "weight must be a number, a diagonal (2,)", "(3,)"),
    ("weight asymmetric", lambda: pose(costs.State([[1, 1], [0, 1]])), "weight must be symmetric"),
    ("weight indefinite", lambda: pose(costs.State([[1, 2], [2, 1]])), "weight must be positive semidefinite"),
    ("R zero", lambda: pose(costs.Tracking(1, 0, 1)), "R must be positive definite", "eigenvalue 0"),
    ("R singular", lambda: pose(costs.Tracking(1, [[0.0]], 1)), "R must be positive definite"),
    ("Q negative", lambda: pose(costs.Tracking(-1, 1, 1)), "Q must be positive semidefinite"),
    ("Q_final shape", lambda: pose(costs.Tracking(1, 1, np.eye(3))), "Q_final must be", "got shape (3, 3)"),
    ("x_target shape", lambda: pose(costs.Tracking(1, 1, 1, [1])), "x_target must be a state (2,)", "(1,)"),
    ("target shape", lambda: state(target=[0, 0, 0]), "target must be a state (2,)", "got shape (3,)"),
    ("target nan", lambda: state(target=[0, nan]), "target must be finite"),
    ("target text", lambda: state(target="start"), "target " + NUMBERS),
    ("when unknown", lambda: state(when="finally"), "unknown when 'finally'; there are: running, terminal"),
    ("when beyond", lambda: state(when=11), "when names knot 11", "knots 0 to 10"),
    ("when between", lambda: state(when=0.12), "time 0.12 s, at which there is no knot", "nearest is knot 2"),
    ("when nan", lambda: state(when=nan), "when names the time nan s"),
    ("when none", lambda: state(when=None), "when must be 'running'", "got NoneType None"),
    ("when empty", lambda: state(when=[]), "when must pick at least one of the knots 0 to 10"),
    ("when falling", lambda: state(when=[3, 2]), "when must name knots in ascending order", "got 3, 2"),
    ("when for controls", lambda: pose(costs.Control(1.0, 0.0, "terminal")), "when must name steps for controls"),
    ("loss unknown", lambda: state(loss="abs"), "unknown loss 'abs'; there are: quadratic, smooth-abs"),
    ("width negative", lambda: state(loss="huber", width=-1), "width must be positive and finite", "-1"),
    ("width of none", lambda: state(width=1.0), "width is for the losses smooth-abs, huber"),
    ("terminal weight", lambda: state(terminal_weight=2.0), "with when='always', but when is 'running'"),
    ("sensor unknown", lambda: pose_arm(costs.Sensor("hnad", 0.0)), "unknown sensor 'hnad'; there are: hand, turn",
     "did you mean 'hand'?"),
    ("sensor of none", lambda: pose(costs.Sensor("hand", 0.0)), "unknown sensor 'hand'; there are: none"),
    ("sensor target", lambda: pose_arm(costs.Sensor("hand", [0, 0])), "target must be a number, a vector (3,)"),
    ("sensor no target", lambda: pose_arm(costs.Sensor("hand", None)), "target must be finite"),
    ("quaternion zero", lambda: pose_arm(costs.Sensor("turn", [0, 0, 0, 0])), "must be a quaternion, not zeros"),
    ("r text", lambda: residual("x"), "r(x, u, t) must be a function", "got str 'x'"),
    ("r returns none", lambda: residual(lambda x, u, t: None), "r(x, u, t) must return real numbers", "NoneType"),
    ("r returns text", lambda: residual(lambda x, u, t: "far"), "must return real numbers", "got str 'far'"),
    ("r returns bool", lambda: residual(lambda x, u, t: x[0] < 1.0), "must return real numbers"),
    ("r returns matrix", lambda: residual(lambda x, u, t: np.eye(2)), "a number or numbers in a row (m,)", "(2, 2)"),
    ("r returns nothing", lambda: residual(lambda x, u, t: []), "a number or numbers in a row (m,)", "(0,)"),
    ("r returns ragged", lambda: residual(lambda x, u, t: [[1], [1, 2]]), "must return real numbers", "got list"),
    ("r of two", lambda: residual(lambda x, u: x), "r(x, u, t) fails", "2 positional arguments but 3 were given"),
    ("r raises", lambda: residual(raising), "r(x, u, t) fails for x of shape (2,): KeyError: 'hand'"),
    ("r writes", lambda: residual(lambda x, u, t: x.__iadd__(1.0)), "r(x, u, t) fails", "read-only"),
    ("jacobian text", lambda: residual(lambda x, u, t: x, jacobian="auto"), "jacobian must be a function"),
    ("parameters nan", lambda: residual(lambda x, u, t, p: x, parameters=[nan]), "parameters must be finite"),
    ("cost returns array", lambda: pose(costs.Function(lambda x, u, t: x)), "must return a number, got shape (2,)"),
    ("cost returns none", lambda: pose(costs.Function(lambda x, u, t: None)), "must return real numbers"),
    ("cost is a number", lambda: pose(costs.Function(1.0)), "l(x, u, t) must be a function", "got float 1.0"),
    ("hessian text", lambda: pose(costs.Function(lambda x, u, t: 0.0, hessian="x")), "hessian must be a function"),
)  # fmt: skip
def test_costs(call, fragments):
    refused(call, *fragments)


@table(
    ("u reversed", lambda: limited(u=(1, -1)), "lower limit of control 'u[0]' must not lie above", "got 1 and -1"),
    ("u nan", lambda: limited(u=(nan, 1)), "must not be NaN; write -inf or inf for none"),
    ("u number", lambda: limited(u=3), 'u must be "model", None or a pair (lower, upper), got 3'),
    ("u name", lambda: limited(u="none"), 'u must be "model", None or a pair', "got 'none'"),
    ("u shape", lambda: limited(u=([1, 2], [3, 4])), "one a control (1,)", "got shape (2,)"),
    ("x reversed", lambda: limited(x=(1, -1)), "bounds: x: lower must not lie above upper", "'x[0]' at knot 0"),
    ("x number", lambda: limited(x=2), "x must be None or a pair (lower, upper), got 2"),
    ("x shape", lambda: limited(x=([1, 2, 3], None)), "bounds: x: lower must be a number", "got shape (3,)"),
    ("x without limits", lambda: limited(x=(None, None)), "there is no finite limit; give lower, upper or both"),
    ("reversed", lambda: held(constraints.State(1, -1)), "lower must not lie above upper", "got 1 and -1"),
    ("no limit", lambda: held(constraints.State()), "there is no finite limit"),
    ("nan", lambda: held(constraints.State(nan)), "lower must not be NaN"),
    ("text", lambda: held(constraints.State("low")), "lower " + NUMBERS),
    ("shape", lambda: held(constraints.State([1, 2, 3])), "one an entry (2,)", "got shape (3,)"),
    ("against bounds", lambda: held(constraints.Control(2, 3), bounds=Bounds(u=(-1, 1))),
     "limits of the control 'u[0]' leave nothing at step 0", "[-1, 1]", "[2, 3]"),
    ("same name", lambda: held(constraints.State(-1, 1, name="a"), constraints.State(-2, 2, name="a")), "name 'a'"),
    ("name taken", lambda: held(constraints.State(-1, 1, name="controls")), "belongs to the limits of the controls"),
    ("name number", lambda: held(constraints.State(-1, 1, name=3)), "name must be a text that is not empty, got 3"),
    ("sensor", lambda: pose_arm(constraints=[constraints.Sensor("hnad", 0)]), "unknown sensor 'hnad'", "hand, turn"),
    ("orientation", lambda: pose_arm(constraints=[constraints.Sensor("turn", 0)]), "reads an orientation"),
    ("path none", lambda: held(constraints.Path(lambda x, u, t: None)), "w(x, u, t) must return real numbers"),
    ("path bool", lambda: held(constraints.Path(lambda x, u, t: x[0] < 1)), "must return real numbers"),
    ("path at", lambda: held(constraints.Path(lambda x, u, t: x[0], at="middle")), "unknown at 'middle'"),
    ("path equality", lambda: held(constraints.Path(lambda x, u, t: x[0], equality="yes")), "must be True or False"),
    ("terminal of two", lambda: held(constraints.Terminal(lambda x, u: x[0])), "fails for x of shape (2,)"),
    ("terminal number", lambda: held(constraints.Terminal(3)), "m(x) must be a function", "got int 3"),
    ("terminal jacobian", lambda: held(constraints.Terminal(lambda x: x, jacobian="x")), "jacobian must be a function"),
    ("initial nothing", lambda: held(constraints.Initial()), "give q(x), the entries of the initial state"),
    ("initial name", lambda: held(constraints.Initial(free="speed")), "unknown free: state 'speed'", "x[0], x[1]"),
    ("initial index", lambda: held(constraints.Initial(free=2)), "free must name entries of the state, 0 to 1"),
    ("when", lambda: held(constraints.State(-1, 1, when="end")), "unknown when 'end'; there are: running"),
)  # fmt: skip
def test_limits(call, fragments):
    refused(call, *fragments)


OTHER = pose(horizon=5).rollout([0.0])


@table(
    ("rollout", lambda: pose().rollout(np.zeros((9, 1))), "must have shape (10, 1) or (1,), got (9, 1)"),
    ("cost of an array", lambda: pose().cost(np.zeros((11, 2))), "trajectory must be a mjslq.Trajectory", "ndarray"),
    ("cost of another", lambda: pose().cost(OTHER), "must have 10 steps, 2 states and 1 controls, got 5, 2 and 1"),
    ("gradient of another", lambda: pose().gradient(OTHER), "trajectory must have 10 steps", "got 5"),
    ("violation of another", lambda: pose().violation(OTHER), "trajectory must have 10 steps", "got 5"),
    ("another start", lambda: pose().at([0.0]), "x0 must have shape (2,), got (1,)"),
    ("another time", lambda: pose().at([0.0, 0.0], "now"), "t0 must be an array of numbers"),
    ("no controls", lambda: solve(pose(dynamics=MODEL, x0=[0.0])), "x0 must have shape (2,)"),
)  # fmt: skip
def test_uses_of_a_problem(call, fragments):
    refused(call, *fragments)


def test_starts_outside_of_their_limits_end_as_infeasible_and_say_what_to_do():
    for problem in (pose(x0=[2.0, 0.0], bounds=Bounds(x=(-1, 1))), held(constraints.State(-1, 1), x0=[2.0, 0.0])):
        result = solve(problem, max_iterations=30)
        assert result.status is Status.INFEASIBLE and "cannot be met from here" in result.message


def test_controls_to_start_from_that_lie_outside_are_clipped_and_said_to_be():
    result = solve(pose(bounds=Bounds(u=(-1, 1))), U0=np.full((10, 1), 9.0), max_iterations=0)
    assert "clipped to the limits of the controls at 10 steps" in result.message and result.trajectory.U.max() <= 1.0


def test_controls_that_cost_nothing_are_named_as_the_reason():
    costless = Problem(PENDULUM, 10, [1.0, 0.0], [costs.State(1.0, None, "terminal")])
    result = solve(costless)
    assert not result.success and "Give each control a cost, such as mjslq.costs.Control" in result.message
    at_rest = Problem(PENDULUM, 10, [0.0, 0.0], [costs.State(1.0, None, "terminal")])
    assert solve(at_rest).success  # nothing is to be gained: no direction is needed
