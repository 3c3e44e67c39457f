"""What terms take besides a weight: knots, losses, weights of the end, targets at listed knots; labels and time."""

import numpy as np
import pytest
from numba import njit

import mjslq
from mjslq import FunctionDynamics, Problem, costs

NX, NU, N = 3, 2, 6
DT = np.array([0.1, 0.2, 0.15, 0.05, 0.3, 0.1])
TIMES = np.concatenate([[0.0], np.cumsum(DT)])


def outputs(x, u, t):
    return np.stack([x[0] * x[1], x[2]])


dynamics = FunctionDynamics(lambda x, u: -x, NX, NU, DT, outputs=outputs, output_names=("hand[0]", "hand[1]"))
rng = np.random.default_rng(0)
trajectory = dynamics.rollout(rng.standard_normal(NX), rng.standard_normal((N, NU)))


def make(*terms):
    return Problem(dynamics, N, np.zeros(NX), list(terms))


def timed(x, u, t):
    return (x - t) * t


def timed_cost(x, u, t):
    return (x[0] - t) * (x[0] - t) + u[0] * t


# Weights of the end


@pytest.mark.parametrize(
    "term",
    [
        lambda weight, when, **more: costs.State(weight, np.ones(NX), when, **more),
        lambda weight, when, **more: costs.Sensor("hand", [1.0, 2.0], weight, when, **more),
        lambda weight, when, **more: costs.Residual(timed, weight, when, **more),
    ],
    ids=["state", "sensor", "residual"],
)
@pytest.mark.parametrize("loss", ["quadratic", "huber"])
def test_terminal_weight_is_the_weight_of_the_terminal_value(term, loss):
    together = make(term(2.0, "always", terminal_weight=50.0, loss=loss))
    apart = make(term(2.0, "running", loss=loss), term(50.0, "terminal", loss=loss))
    assert together.cost(trajectory) == pytest.approx(apart.cost(trajectory), rel=1e-13)
    for ours, theirs in zip(together.expand(trajectory), apart.expand(trajectory), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-13)
    same = make(term(2.0, "always", loss=loss)), make(term(2.0, "always", terminal_weight=2.0, loss=loss))
    assert same[0].cost(trajectory) == pytest.approx(same[1].cost(trajectory), rel=1e-13)


def test_a_terminal_weight_of_zero_leaves_the_integral():
    ours, theirs = make(costs.State(2.0, when="always", terminal_weight=0.0)), make(costs.State(2.0))
    assert ours.cost(trajectory) == pytest.approx(theirs.cost(trajectory), rel=1e-14)


# Knots and targets


def test_values_at_listed_knots_are_no_integral():
    knots = [1, 4, 6]
    J = 0.5 * sum(3.0 * (trajectory.X[n] ** 2).sum() for n in knots)
    for when in (knots, TIMES[knots], [1, 4, -1], np.array(knots)):
        assert make(costs.State(3.0, when=when)).cost(trajectory) == pytest.approx(J, rel=1e-13)
    J = 1.5 * (trajectory.X[1] ** 2).sum()
    assert make(costs.State(3.0, when=0.1)).cost(trajectory) == pytest.approx(J, rel=1e-13)


def test_initial_terms_act_at_the_start():
    problem = make(costs.State(2.0, when="initial"), costs.Control(2.0, when="initial"))
    J = (trajectory.X[0] ** 2).sum() + (trajectory.U[0] ** 2).sum()
    assert problem.cost(trajectory) == pytest.approx(J, rel=1e-13)


def test_targets_one_for_each_listed_knot():
    targets, knots = rng.standard_normal((2, NX)), [2, 5]
    every = np.zeros((N + 1, NX))
    every[knots] = targets
    ours, theirs = (make(costs.State(1.0, target, knots)) for target in (targets, every))
    assert ours.cost(trajectory) == theirs.cost(trajectory) > 0.0
    ours, theirs = (make(costs.Sensor("hand", target, 1.0, knots)) for target in (targets[:, :2], every[:, :2]))
    assert ours.cost(trajectory) == theirs.cost(trajectory) > 0.0
    ours, theirs = (make(costs.Control(1.0, target, knots)) for target in (targets[:, :2], every[:N, :2]))
    assert ours.cost(trajectory) == theirs.cost(trajectory) > 0.0


def test_a_control_weight_may_be_zero_for_some_controls():
    J = 0.5 * (DT * trajectory.U[:, 1] ** 2).sum()
    assert make(costs.Control([0.0, 1.0])).cost(trajectory) == pytest.approx(J, rel=1e-13)


def test_semidefinite_control_weights_are_solved_where_the_sum_is_definite():
    """Each control has a weight of its own; together they are one definite weight."""
    start, goal = [1.0, -1.0, 0.5], costs.State(1.0, when="always")
    driven = FunctionDynamics(lambda x, u: np.stack([x[1], u[0], u[1] - x[2]]), NX, NU, 0.1)
    apart = Problem(driven, 20, start, [goal, costs.Control([2.0, 0.0]), costs.Control([0.0, 3.0])])
    together = Problem(driven, 20, start, [goal, costs.Control([2.0, 3.0])])
    ours, theirs = mjslq.solve(apart, "slq"), mjslq.solve(together, "slq")
    assert ours.success and theirs.success
    np.testing.assert_allclose(ours.trajectory.U, theirs.trajectory.U, atol=1e-9)


# Labels and time


@pytest.mark.parametrize(
    "term, labels",
    [
        (costs.State(1.0), ["State, running"]),
        (costs.State(1.0, when="always"), ["State, always"]),
        (costs.State(1.0, when="always", terminal_weight=2.0), ["State, running", "State, terminal"]),
        (costs.Control(1.0, when=slice(0, 2)), ["Control, knots 0, 1"]),
        (costs.Sensor("hand", 0.0, when="terminal"), ["Sensor 'hand', terminal"]),
        (costs.Residual(timed, when=-1), ["Residual 'timed', knot 6"]),
        (costs.Residual(njit(timed)), ["Residual 'timed', running"]),
        (costs.Function(timed_cost, "initial"), ["Function 'timed_cost', initial"]),
        (costs.Tracking(1.0, 1.0, 1.0), ["Tracking, states", "Tracking, final state", "Tracking, controls"]),
    ],
)
def test_terms_say_what_they_are(term, labels):
    assert [bound.label for bound in term.bind(dynamics, N)] == labels


@pytest.mark.parametrize(
    "term",
    [costs.Residual(timed, when="always"), costs.Residual(njit(timed)), costs.Function(timed_cost, when="always"),
     costs.Residual(timed, when=[0.1, 0.3], loss="smooth-abs")],
    ids=["residual", "compiled", "function", "knots"],
)  # fmt: skip
def test_terms_move_in_time(term):
    """`at` counts from the horizon's own start, whatever came before; what was there stays as it was."""
    (bound,) = term.bind(dynamics, N)
    late = bound.at(3.0)
    f = term.l if isinstance(term, costs.Function) else getattr(term.r, "py_func", term.r)

    def shifted(x, u, t):
        return f(x, u, t + 3.0)

    given = {"when": term.when} | ({} if isinstance(term, costs.Function) else {"loss": term.loss})
    reference = make(type(term)(shifted, **given))
    now = bound.cost(trajectory)
    assert late.cost(trajectory) == pytest.approx(reference.cost(trajectory), rel=1e-12)
    assert late.cost(trajectory) != pytest.approx(now, rel=1e-3)
    assert late.at(0.0).cost(trajectory) == now == bound.cost(trajectory)
    assert bound.at(1.0).at(3.0).cost(trajectory) == late.cost(trajectory)
    assert late.label == bound.label
    ours, linearization = mjslq.costs.Expansion.zeros(N, NX, NU), dynamics.linearize(trajectory)
    late.expand(trajectory, linearization, ours)
    for a, b in zip(ours, reference.expand(trajectory, linearization), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("term", [costs.State(1.0), costs.Control(1.0), costs.Sensor("hand", 0.0)])
def test_terms_without_time_stay_themselves(term):
    (bound,) = term.bind(dynamics, N)
    assert bound.at(3.0) is bound


# What is refused, and how


@pytest.mark.parametrize(
    "term, sentence",
    [
        (costs.State(1.0, loss="abs"), r"\(State\): unknown loss 'abs'; there are: quadratic, smooth-abs, huber, pseu"),
        (costs.State(1.0, width=0.1), r"\(State\): width is for the losses smooth-abs, huber, pseudo-huber"),
        (costs.Sensor("hand", 0.0, 1.0, "terminal", "huber", 0.0), r"width must be positive and finite, got 0"),
        (costs.Control(0.0, loss="square"), r"\(Control\): unknown loss 'square'"),
        (costs.Residual(timed, loss="huber", width=[1.0, 2.0]), r"\(Residual\): width must be a number, got list"),
        (
            costs.State(1.0, terminal_weight=2.0),
            r"terminal_weight is the weight of the terminal value with when='al",
        ),
        (costs.State(1.0, when=[1], terminal_weight=2.0), r"with when='always', but when is \[1\]"),
        (
            costs.Sensor("hand", 0.0, when="always", terminal_weight=-2.0),
            "terminal_weight must be positive semidef",
        ),
        (costs.State(1.0, when="always", terminal_weight=np.eye(2)), r"terminal_weight must be a number, a diagonal"),
        (
            costs.Control(1.0, when="terminal"),
            r"\(Control\): when must name steps for controls, 0 to 5: at the term",
        ),
        (costs.Control(1.0, when="always"), "when must name steps for controls"),
        (costs.Control(1.0, when=-1), "at the terminal knot 6 there is none"),
        (costs.State(1.0, when=9), r"\(State\): when names knot 9, but there are the knots 0 to 6"),
        (
            costs.State(1.0, when=0.25),
            "when names the time 0.25 s, at which there is no knot; the nearest is knot 2",
        ),
        (costs.Function(timed_cost, when=[3, 1]), "when must name knots in ascending order"),
        (costs.State(1.0, np.zeros((3, NX)), [1, 2]), r"target must be a state \(3,\) or one a knot \(7, 3\), got"),
        (
            costs.Sensor("hand", np.zeros((3, 2)), when=[1, 2]),
            r"target must be a number, a vector \(2,\) or one",
        ),
    ],
)
def test_wrong_options_are_refused_in_one_sentence(term, sentence):
    with pytest.raises(ValueError, match=r"^costs\[0\] .*" + sentence) as caught:
        make(term)
    assert "\n" not in str(caught.value)
