"""The hopper: solve it, say what it does, and watch it.

Run with    python demos/01_hopper.py [height in inches]
"""

import sys

import mjslq
from mjslq.problems.hopper import phases


def main() -> None:
    height = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0

    # A problem of the catalogue: the machine as a MuJoCo model, and the cost (66) of Sideris and Bobrow 2005.
    problem = mjslq.problems.get("hopper", height=height)

    # One line an iteration; Ctrl-C ends the solve with the best motion so far.
    result = mjslq.solve(problem, verbose=1)

    # States are knots by entries: height and piston, then their velocities.
    X = result.trajectory.X
    print(f"\nreached {X[-1, 0]:.3f} in of {height:g} in at speed {X[-1, 2]:+.2f} in/s")
    print("phases:", ", ".join(phases(X)))

    # Feedback gains come for free. Here they bring a start that is 0.2 in too high back to the plan.
    pushed = X[0] + [0.2, 0.0, 0.0, 0.0]
    still = result.gains * 0.0
    dynamics, plan = problem.dynamics, result.trajectory
    for name, K in (("without", still), ("with", result.gains)):
        end = dynamics.rollout_feedback(plan, K, 0.0 * plan.U, x0=pushed).X[-1, 0]
        print(f"pushed by 0.2 in, {name} feedback: ends at {end:.3f} in")

    result.save("hopper.npz")
    mjslq.view(result)


if __name__ == "__main__":
    main()
