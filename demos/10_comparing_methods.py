"""Every method on one problem from the same start: the hopper, and a swing-up with limits.

Run with    python demos/10_comparing_methods.py
"""

import mjslq


def main() -> None:
    for name in ("hopper", "double_pendulum"):
        problem = mjslq.problems.get(name)
        print(f"{name}\n  method         status            iterations   rollouts           cost   seconds")
        best = None
        for method in ("auto", "slq", "newton", "trust-region", "pronto"):
            result = mjslq.solve(problem, method, max_iterations=150)
            rollouts = sum(entry.evaluations for entry in result.log)
            print(
                f"  {method:13s}  {result.status.value:16s}  {result.iterations:10d}   {rollouts:8d}   "
                f"{result.cost:12.8g}   {result.seconds:7.2f}"
            )
            if result.success and (best is None or result.cost < best.cost):
                best = result
        mjslq.view(best)


if __name__ == "__main__":
    main()
