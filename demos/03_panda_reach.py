"""A Panda reaches for a point, on both engines: the same problem, the same motion, and what an iteration costs.

Run with    python demos/03_panda_reach.py [python script]

Another solver can be put beside it: `script` states the same problem, is run by the interpreter `python` of that
solver's own environment, and prints one JSON line with "solver", "iterations", "cost", "solve_ms" and "ms".
"""

import json
import subprocess
import sys
import time

import mjslq
from mjslq.problems.panda_reach import OPTIMAL_COST


def milliseconds(call, repeat=20):
    """Least time of a call. [ms]"""
    call()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return 1e3 * min(times)


def main() -> None:
    results = {}
    for engine in ("pinocchio", "mujoco"):
        problem = mjslq.problems.get("panda_reach", engine=engine)
        mjslq.solve(problem)  # once before, so that no kernel is compiled on the clock
        result = results[engine] = mjslq.solve(problem, keep_iterates=False)
        dynamics, plan = problem.dynamics, result.trajectory
        phases = {
            "rollout": milliseconds(lambda d=dynamics, p=plan: d.rollout(p.X[0], p.U)),
            "linearize": milliseconds(lambda d=dynamics, p=plan: d.linearize(p)),
        }
        report(f"mjslq on {engine}", result.iterations, result.cost, 1e3 * result.seconds, phases)
        print(f"{'':24}{problem.describe(plan)['hand']}; cost {result.cost / OPTIMAL_COST - 1.0:+.0e} of the reference")
    if len(sys.argv) == 3:
        peer = json.loads(subprocess.run(sys.argv[1:], check=True, capture_output=True, text=True).stdout)
        report(peer["solver"], peer["iterations"], peer["cost"], peer["solve_ms"], peer["ms"])

    # The engines' plans are the same to many digits: either's controls and gains steer the other's robot.
    ours, theirs = (results[engine].trajectory for engine in ("pinocchio", "mujoco"))
    print(f"largest difference of the torques: {abs(ours.U - theirs.U).max():.1e} Nm")
    mjslq.view(results["pinocchio"])


def report(solver: str, iterations: int, cost: float, total: float, phases: dict[str, float]) -> None:
    parts = ", ".join(f"{name} {value:.2f}" for name, value in phases.items())
    print(f"{solver:24}{iterations} iterations, cost {cost:.9f}, {total:.0f} ms in all; one call each [ms]: {parts}")


if __name__ == "__main__":
    main()
