"""Lengths of steps that functions hold as numbers, where the final time is free."""

import dataclasses
import warnings

import numpy as np
import pytest
from numba import njit

from mjslq import FunctionDynamics, Problem, constraints, costs, problems

DT = 0.05
OTHER = 0.07


def mass(x, u):
    return np.array([x[1], u[0]])


def ahead(x, u, t):
    return x[:1] + DT * x[1:]


def of(length):
    def inner(x, u, t, h=DT):
        return x[:1] + length * x[1:]

    return inner


def pose(terms=(), dynamics=None, dt=DT, free_time=(0.5, 2.0), held=()):
    dynamics = FunctionDynamics(mass, 2, 1, dt) if dynamics is None else dynamics
    terms = [costs.Control(1.0), *terms]
    return Problem(dynamics, 20, [1.0, 0.0], terms, free_time=free_time, constraints=held)


def told(make):
    with pytest.warns(UserWarning, match="length of a step as it was given, and will not stretch") as caught:
        make()
    assert caught[0].filename == __file__ or "dataclasses" in caught[0].filename
    return str(caught[0].message).split(" 0.05, ")[0]


def test_the_residual_of_the_catalogue_is_told():
    problem = problems.get("van_der_pol")
    made = told(lambda: dataclasses.replace(problem, free_time=(1.0, 9.0)))
    assert made == "costs[0]: parameters[0] is"


def test_variables_and_parameters_are_told():
    swept = FunctionDynamics(njit(lambda x, u, t, p: u - DT * x), 1, 1, DT, integrator="euler", parameters={"dt": DT})
    assert told(lambda: pose([costs.Residual(ahead)])) == "costs[1]: DT in ahead is"
    assert told(lambda: pose([costs.Residual(of(3.0))])) == "costs[1]: h in inner is"
    assert told(lambda: pose(held=[constraints.Path(ahead)])) == "constraints[0]: DT in ahead is"
    found = told(lambda: Problem(swept, 20, [1.0], [costs.Control(1.0)], free_time=(0.5, 2.0)))
    assert found == "dynamics: the parameter dt; dynamics: DT in <lambda> are"


def test_other_numbers_and_fixed_times_are_no_matter():
    weight, h = 0.05, OTHER

    def residual(x, u, t):
        return weight * x[:1] + h * x[1:]

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pose([costs.Residual(residual)])
        pose([costs.Residual(ahead)], free_time=None)
        pose([costs.Residual(ahead)], dt=np.linspace(0.04, 0.06, 20))
        pose([costs.Residual(ahead)], dt=OTHER)
