"""The drag particle: Table 1 of Sideris and Bobrow 2005, and what lies beyond it.

Run with    python demos/02_drag_particle.py
"""

import mjslq
from mjslq.problems.drag_particle import BETAS, PAPER_ITERATIONS


def main() -> None:
    print("  beta   paper   iterations   rollouts            cost   |gradient|   status")
    for beta in BETAS:
        problem = mjslq.problems.get("drag_particle", beta=beta)
        result = mjslq.solve(problem)
        rollouts = sum(entry.evaluations for entry in result.log)
        print(
            f"{beta:6.2f}   {PAPER_ITERATIONS[beta] or 'none':>5}   {result.iterations:10d}   {rollouts:8d}   "
            f"{result.cost:13.10g}   {result.gradient_norm:10.1e}   {result.status.value}"
        )

    # The same system from your own equations: m x'' = u - beta |v| v, by explicit Euler with 500 steps in a second.
    # Written so that complex steps can differentiate it: no abs().
    def drag(x, u):
        v = x[1]
        return [v, (u[0] - 0.1 * v * v * (1.0 if v.real > 0.0 else -1.0)) / 0.0259]

    own = mjslq.Problem(
        dynamics=mjslq.FunctionDynamics(drag, nx=2, nu=1, dt=1 / 500, integrator="euler"),
        horizon=500,
        x0=[0.0, 0.0],
        costs=[
            mjslq.costs.Control(20.0),
            mjslq.costs.State(2.0),
            mjslq.costs.State([2e6, 0.0], target=[10.0, 0.0], when="terminal"),
        ],
    )
    result = mjslq.solve(own, tol_direction=0.0)
    print(f"\nfrom plain Python, beta = 0.1: {result.status.value}, cost {result.cost:.10g} in {result.seconds:.2f} s")
    mjslq.view(mjslq.solve(mjslq.problems.get("drag_particle", beta=1.0)))


if __name__ == "__main__":
    main()
