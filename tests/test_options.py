"""Options: every one of every method, refused in one sentence where name or value is wrong, wherever it was written."""

import dataclasses
import math

import numpy as np
import pytest
from small_problems import drag, pendulum

import mjslq
from mjslq import Status, problems, solve
from mjslq.method_table import PRESETS, option_names
from mjslq.options import COMMON, RECORDS, SLQOptions, Stopping, TrustRegionOptions, check, names

METHODS = sorted(RECORDS)
SEARCH = {
    "line_search": (["quadratic-fit", "armijo", "goldstein", "wolfe", "exact"], ["fit", "", None, 1, True]),
    "step": (["closed-loop", "open-loop"], ["auto", "closed", None, 0]),
    "acceleration": ([True, False], [1, 0, "no", None]),
}
STEP = {"step": SEARCH["step"]}
NUMBER = [0.0, -1.0, math.nan, math.inf, "much", [1.0, 2.0]]
TOLERANCE = ([0.0, 1e-9, 1, np.float64(0.1), np.int64(2)], [-1e-9, math.nan, math.inf, "small", True, [1e-6]])
CURVES = {
    "gains": (["lqr", "none"], ["lq", "", None, 3.0, [1.0]]),
    "regulator": (
        [None, (1.0, 1.0), ((2.0, 1.0), 0.1, 5.0)],
        [1.0, "QR", (1.0,), (1.0, 1.0, 1.0, 1.0), (1.0, "R"), (-1.0, 1.0), (1.0, math.nan)],
    ),
    "limits": (["barrier", "clip"], ["bounds", None]),
    "barrier": ([1e-6, 0.1, 1], [*NUMBER, None]),
}
VALUES = {
    "auto": {"curvature": (["auto", "always", "never"], ["newton", None, True])},
    "slq": SEARCH
    | {
        "multiplier": ([None, "control", "state"], ["controls", 1.0, True]),
        "damping": ([1e-9, 1.0, 5, np.float64(3.0)], [*NUMBER, None]),
        "rescue": ([True, False], [1, "yes", None]),
    },
    "newton": SEARCH
    | {
        "modification": (["multiplier", "blend", "stage"], ["stages", None]),
        "costates": (["sweep", "adjoint"], ["adjont", None]),
    },
    "trust-region": STEP
    | {
        "radius": ([1e-3, 10], [*NUMBER, None]),
        "eta": ([(0.1, 0.9), [0.2, 0.3]], [(0.8, 0.2), (0.0, 0.5), (0.5, 1.0), 0.5, (0.1, 0.5, 0.9), "ab", None]),
        "gamma": ([(0.5, 3.0), [0.1, 1.5]], [(0.5, 0.9), (1.5, 2.0), (0.0, 2.0), 2.0, None, (math.nan, 2.0)]),
        "hessian": (["newton", "gauss-newton"], ["exact", None]),
    },
    "gradient": {"line_search": SEARCH["line_search"]},
    "pronto": CURVES
    | {
        "order": (["first", "gauss-newton", "newton"], ["second", None]),
        "globalize": (["blend", "gauss-newton", "gopronto", "none"], ["yes", None]),
    },
    "gopronto": CURVES
    | {
        "variant": (["gradient", "conjugate", "heavy-ball", "nesterov", "quasi-newton"], ["momentum", None]),
        "step_rule": (["armijo", "interpolated", "fixed", "diminishing"], ["exact", None]),
        "step_size": ([1e-4, 0.1], [*NUMBER, None]),
        "momentum": ([0.0, 0.5, np.float64(0.9)], [-0.1, 1.0, math.nan, "much", True, None]),
        "restarts": ([True, False], [1, "no", None]),
    },
    "constrained": {
        "curvature": (["auto", "always", "never"], ["newton", None, True]),
        "tol_violation": ([1e-9, 1e-3, 1], [*NUMBER, None]),
        "penalty": ([0.01, 10.0, 2], [*NUMBER, None]),
    },
    "square-root-sweep": {
        "tol_violation": ([1e-9, 1], [*NUMBER, None]),
        "cost_decrease": (SHARES := ([0.01, 1], [*NUMBER, 1.1, None])),
        "terminal_share": SHARES,
        "path_share": SHARES,
        "threshold": ([1, 1.1], [*NUMBER, 0.9, None]),
        "cost_row": ([True, False], [1, None]),
        "degradation": TOLERANCE,
        "first": ([(), ("controls",), ["controls"]], ["controls", (1,), None]),
        "overlap": SHARES,
        "step": SEARCH["step"],
        "weights": ([None, (2.0,), [1.0]], [1.0, (0.0,), ("a",), (-1.0,)]),
    },
}
"""Of each method: option -> (right values, wrong values)."""
STOPPING = {
    "tol_direction": TOLERANCE,
    "tol_gradient": TOLERANCE,
    "max_iterations": ([0, 1, np.int64(3)], [-1, 2.5, "many", True]),
    "deadline": ([None, 1e-3, 5], [0.0, -1.0, math.nan, math.inf, "soon"]),
    "lean": ([True, False], [1, "yes"]),
}


def cases(right):
    """(method, option, value), all of them."""
    return [
        pytest.param(method, name, value, id=f"{method}-{name}-{value}")
        for method in METHODS
        for name, both in (VALUES.get(method, {}) | STOPPING).items()
        for value in both[0 if right else 1]
    ]


def test_every_option_of_every_method_is_tested_here():
    for method in METHODS:
        own = {field.name for field in dataclasses.fields(RECORDS[method])}
        assert own == set(VALUES[method]), method
        assert set(names(method)) == own | set(COMMON) == set(option_names(method))
    assert {field.name for field in dataclasses.fields(Stopping)} == set(STOPPING)
    assert set(COMMON) == {"tol", *STOPPING}


@pytest.mark.parametrize("method, name, value", cases(right=True))
def test_right_values_are_taken_and_kept_on_record(method, name, value):
    result = solve(pendulum(), method, **({"max_iterations": 1} | {name: value}))
    kept = result.options[name]
    assert list(kept) == list(value) if isinstance(value, (tuple, list)) else kept == value
    written = {name: value} if name == "max_iterations" else {name: value, "max_iterations": 1}
    assert solve(pendulum(**written), method).options[name] == kept


@pytest.mark.parametrize("method, name, value", cases(right=False))
def test_wrong_values_are_refused_in_one_sentence_wherever_written(method, name, value):
    if name in ("max_iterations", "deadline") and value is None:
        return
    for write in (
        lambda: solve(pendulum(), method, **{name: value}),
        lambda: pendulum(**{name: value}),
        lambda: {**RECORDS, "stopping": Stopping}["stopping" if name in STOPPING else method](**{name: value}),
    ):
        with pytest.raises(ValueError, match=name) as caught:
            write()
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 250


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("wrong", ["tol_directoin", "linesearch", "max_iter", "Tol", "", "verbos"])
@pytest.mark.parametrize("value", [1, None])
def test_unknown_names_are_refused(method, wrong, value):
    with pytest.raises(
        ValueError, match=rf"unknown option for method '{method}' '{wrong}'; there are: .*tol"
    ) as caught:
        solve(pendulum(), method, **{wrong: value})
    assert "\n" not in str(caught.value)


def test_the_nearest_name_is_told():
    with pytest.raises(ValueError, match=r"did you mean 'line_search'\?"):
        solve(pendulum(), "slq", linesearch="armijo")
    with pytest.raises(
        ValueError, match=r"unknown option 'tol_directoin'; there are: .*; did you mean 'tol_direction'\?"
    ):
        pendulum(tol_directoin=1)
    with pytest.raises(ValueError, match=r"unknown option 'radios'; there are: .*radius.*; did you mean 'radius'\?"):
        pendulum(radios=1.0)


def test_options_of_another_method_are_refused_in_solve_but_not_in_a_problem():
    """A problem may be solved by any method; who calls one knows which."""
    with pytest.raises(ValueError, match="unknown option for method 'newton' 'multiplier'; there are: line_search"):
        solve(pendulum(), "newton", multiplier="state")
    problem = pendulum(multiplier="state", radius=2.0, line_search="armijo")
    assert solve(problem, "slq", max_iterations=1).options["multiplier"] == "state"
    assert "multiplier" not in solve(problem, "newton", max_iterations=1).options
    assert solve(problem, "trust-region", max_iterations=0).log[0].radius == 2.0
    assert solve(problem, "gradient", max_iterations=1).iterations == 1


def test_options_of_problems_are_checked_as_a_whole():
    check({})
    check({"tol": 1e-3, "eta": (0.1, 0.9), "line_search": "exact"})
    with pytest.raises(ValueError, match="unknown option 3"):
        check({3: 1.0})
    with pytest.raises(ValueError, match=r"tol.* must be a number of at least 0, got -1"):
        check({"tol": -1})
    for name in problems.names():  # the catalogue's own are right
        check(problems.get(name).options)


def test_what_was_asked_for_goes_before_the_preset_and_that_before_the_problem():
    problem = pendulum(step="closed-loop", multiplier="state", tol_direction=1e-2)
    faithful = solve(problem, "slq", preset="sideris-bobrow", max_iterations=1)
    assert faithful.options["step"] == "open-loop" and faithful.options["multiplier"] is None
    assert faithful.options["tol_direction"] == 1e-2
    mixed = solve(problem, "slq", preset="sideris-bobrow", step="closed-loop", max_iterations=1)
    assert mixed.options["step"] == "closed-loop" and mixed.options["acceleration"] is False
    assert solve(problem, "slq", multiplier=None, max_iterations=1).options["multiplier"] is None


def test_tol_stands_for_both_tolerances_unless_they_are_given():
    def tolerances(problem, **options):
        kept = solve(problem, "slq", max_iterations=0, **options).options
        return kept["tol_direction"], kept["tol_gradient"]

    assert tolerances(pendulum()) == (1e-6, 1e-6)
    assert tolerances(pendulum(), tol=1e-3) == (1e-3, 1e-3)
    assert tolerances(pendulum(), tol=1e-3, tol_gradient=1e-5) == (1e-3, 1e-5)
    assert tolerances(pendulum(tol=1e-2)) == (1e-2, 1e-2)
    assert tolerances(pendulum(tol_gradient=1e-2), tol=1e-4) == (1e-4, 1e-4)
    assert tolerances(pendulum(tol_gradient=1e-2), tol_direction=1e-4) == (1e-4, 1e-2)


@pytest.mark.parametrize("tol", [-1.0, math.nan, math.inf, "small", True])
def test_wrong_tolerances_are_refused(tol):
    with pytest.raises(ValueError, match=r"tol.* must be a number of at least 0"):
        solve(pendulum(), tol=tol)


# Presets and other names


def test_the_preset_of_the_paper_is_its_algorithm_and_nothing_else():
    """Open loop, no parallel tangents, no multiplier, no rescue, with the line search by Armijo or by parabola."""
    for line_search, iterations in (("armijo", 28), ("quadratic-fit", 20)):
        result = solve(drag(0.1), "slq", preset="sideris-bobrow", line_search=line_search)
        assert result.success and result.cost == pytest.approx(1197.838874, rel=1e-9)
        assert result.iterations <= iterations
        assert all(entry.multiplier == 0.0 for entry in result.log)
        kept = {name: result.options[name] for name in ("step", "acceleration", "rescue", "multiplier")}
        assert kept == {"step": "open-loop", "acceleration": False, "rescue": False, "multiplier": None}
        for before, after, entry in zip(result.iterates, result.iterates[1:], result.log, strict=False):
            along = (after.U - before.U) / entry.alpha  # a multiple of the direction, nothing added
            assert np.linalg.norm(along) == pytest.approx(entry.direction_norm, rel=1e-6)


def test_presets_are_complete_and_right():
    for method, presets in PRESETS.items():
        for options in presets.values():
            RECORDS[method](**options)
    with pytest.raises(ValueError, match="unknown preset of method 'slq' 'sideris'; there are: sideris-bobrow"):
        solve(pendulum(), "slq", preset="sideris")
    with pytest.raises(ValueError, match="method 'newton' has no presets; 'slq' has: sideris-bobrow"):
        solve(pendulum(), "newton", preset="sideris-bobrow")


def test_ilqr_is_slq():
    by_alias, by_name = (solve(pendulum(), method) for method in ("ilqr", "slq"))
    assert by_alias.method == by_name.method == "slq" and by_alias.options == by_name.options
    np.testing.assert_array_equal(by_alias.trajectory.U, by_name.trajectory.U)
    assert option_names("ilqr") == option_names("slq")
    assert solve(pendulum(), "ilqr", line_search="armijo", max_iterations=1).options["line_search"] == "armijo"


def test_methods_that_are_none_are_refused():
    for wrong, sentence in (
        (
            "sql",
            r"unknown method 'sql'; there are: auto, slq, newton, trust-region, gradient, constrained, "
            r"square-root-sweep, pronto, gopronto, ilqr; did you mean 'slq'\?",
        ),
        (None, "unknown method None; there are"),
        ("ddp", "unknown method 'ddp'; there are"),
        (["slq"], "unknown method"),
    ):
        with pytest.raises(ValueError, match=sentence):
            solve(pendulum(), wrong)


# Records


def test_records_are_frozen_and_methods_show_them():
    options = SLQOptions(step="open-loop")
    with pytest.raises(dataclasses.FrozenInstanceError):
        options.step = "closed-loop"
    for method, entry in mjslq.methods().items():
        assert entry.record is RECORDS[method]
        assert entry.options == {field.name: field.default for field in dataclasses.fields(entry.record)}
        assert solve(pendulum(), method, max_iterations=0).options.items() >= entry.options.items()
    assert TrustRegionOptions().eta == (0.25, 0.75)


def test_a_whole_solve_with_every_option_off_its_default():
    result = solve(
        pendulum(), "slq", line_search="wolfe", step="open-loop", acceleration=False, multiplier="state", damping=0.1,
        rescue=False, tol_direction=1e-7, tol_gradient=1e-7, max_iterations=200, deadline=100.0,
    )  # fmt: skip
    assert result.status is Status.CONVERGED, result.message
