"""What the first solve on a computer costs, with nothing compiled yet, beside importing the libraries it needs.

Every case runs in a process of its own, with empty folders for numba's code and for machine code, and once more with
what the first run has left there. What counts is CPU time, user's and system's, of the whole process.

    python mjslq/reports/first_solve.py [case ...]

imports mjslq in these processes only, so that PYTHONPATH says which one is measured. Unix only.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile

ARM = """
<mujoco><option timestep="0.01"/><worldbody><body><joint name="shoulder" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.03"/><body pos="0.5 0 0"><joint name="elbow" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.03"/></body></body></worldbody>
<actuator><motor joint="shoulder" gear="20"/><motor joint="elbow" gear="20"/></actuator></mujoco>
"""
MUSCLES = """
<mujoco><option timestep="0.005"/><worldbody>
<geom name="wrap" type="cylinder" size="0.02 0.1" euler="90 0 0" contype="0" conaffinity="0"/>
<site name="front" pos="0.05 0 0.3"/><site name="back" pos="-0.05 0 0.3"/><site name="front_side" pos="0.05 0 0"/>
<site name="back_side" pos="-0.05 0 0"/><body><joint name="elbow" axis="0 1 0" damping="0.2"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" contype="0" conaffinity="0"/>
<site name="fore" pos="0.02 0 -0.1"/>
<site name="aft" pos="-0.02 0 -0.1"/></body></worldbody><tendon>
<spatial name="flexor"><site site="front"/><geom geom="wrap" sidesite="front_side"/><site site="fore"/></spatial>
<spatial name="extensor"><site site="back"/>
<geom geom="wrap" sidesite="back_side"/><site site="aft"/></spatial></tendon>
<actuator><muscle tendon="flexor" force="80" lengthrange="0.2 0.45"/>
<muscle tendon="extensor" force="80" lengthrange="0.2 0.45"/></actuator></mujoco>
"""
OWN = """
import mjslq
dynamics = mjslq.MujocoDynamics.from_xml({text!r})
target = [0.5] + [0.0] * (dynamics.nx - 1)
problem = mjslq.Problem(dynamics, 50, [0.0] * dynamics.nx, [mjslq.costs.State(1.0, target), mjslq.costs.Control(1e-2)])
result = mjslq.solve(problem, max_iterations=20)
"""
CATALOGUE = """
import mjslq
result = mjslq.solve(mjslq.problems.get({name!r}), max_iterations=20)
"""
CASES = {
    "hopper": ["-m", "mjslq.cli", "solve", "hopper"],
    "arm": ["-c", OWN.format(text=ARM)],
    "G1": ["-c", CATALOGUE.format(name="g1_reach")],
    "muscles": ["-c", OWN.format(text=MUSCLES)],
}
IMPORTS = "import mujoco, numba, scipy.linalg"
LEAST = "import mujoco, scipy.linalg"


def seconds(arguments: list[str], folder: str) -> float:
    """CPU time of a Python process. [s]"""
    environment = os.environ | {"NUMBA_CACHE_DIR": folder, "MJSLQ_CACHE_DIR": folder}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(names: list[str]) -> None:
    """Print a row for each case, and the ratios to the imports beside it."""
    for name in names or CASES:
        with tempfile.TemporaryDirectory() as folder:
            imports = min(seconds(["-c", IMPORTS], folder) for _ in range(3))
            least = min(seconds(["-c", LEAST], folder) for _ in range(3))
            first = seconds(CASES[name], folder)
            again = min(seconds(CASES[name], folder) for _ in range(3))
        print(
            f"{name:8} first {first:6.2f} s, {first / imports:5.1f} times {IMPORTS} ({imports:.2f} s); "
            f"again {again:5.2f} s, {again / least:4.1f} times {LEAST} ({least:.2f} s)",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
