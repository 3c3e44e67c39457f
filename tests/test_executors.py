"""Executors by name; those of Dask and Ray where they are installed."""

import importlib.util
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import mjslq
from mjslq.executors import open_executor


def mass(target):
    """A unit mass is brought to a place [m]."""
    dynamics = mjslq.MujocoDynamics.from_xml(
        '<mujoco><worldbody><body><joint name="x" type="slide"/><geom size=".1" mass="1"/></body></worldbody>'
        '<actuator><motor joint="x"/></actuator></mujoco>', timestep=0.05
    )  # fmt: skip
    costs = [mjslq.costs.Control(0.01), mjslq.costs.State([10.0, 1.0], [target, 0.0], "terminal")]
    return mjslq.Problem(dynamics, 10, np.zeros(2), costs, name="mass")


def test_processes_are_left_to_solve_many_and_threads_are_the_standard_ones():
    with open_executor("processes", 2) as executor:
        assert executor is None
    with open_executor("threads", 2) as executor:
        assert isinstance(executor, ThreadPoolExecutor)
        assert all(solved.success for solved in mjslq.solve_many([mass(0.1), mass(0.2)], executor))


@pytest.mark.parametrize(
    "kind, package", [("dask", "distributed"), ("ray", "ray")]
)  # fmt: skip
def test_a_missing_package_is_named(kind, package, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with (
        pytest.raises(
            ValueError, match=rf'needs the package {package}; install it with: pip install "mjslq\[{kind}\]"'
        ),
        open_executor(kind),
    ):
        pass


@pytest.mark.parametrize(
    "arguments, said",
    [
        (("cluster",), "unknown executor 'cluster'; there are: processes, threads, dask, ray"),
        (("threads", None, "tcp://here:8786"), "an address belongs to the executors dask and ray, not to 'threads'"),
        (("dask", 2, "tcp://here:8786"), "either address or workers"),
    ],
)
def test_wrong_input_is_answered_in_a_sentence(arguments, said):
    with pytest.raises(ValueError, match=said), open_executor(*arguments):
        pass


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # their own
@pytest.mark.parametrize("kind, package", [("dask", "distributed"), ("ray", "ray")])
def test_a_cluster_on_this_machine_gives_what_solve_gives(kind, package):
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    problems = [mass(target) for target in (0.1, 0.2, 0.3)]
    with open_executor(kind, 2) as executor:
        found = list(mjslq.solve_many(problems, executor, ordered=True))
    for solved, problem in zip(found, problems, strict=True):
        assert np.array_equal(solved.result.trajectory.U, mjslq.solve(problem).trajectory.U), solved.error
