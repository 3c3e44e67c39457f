"""Every method on one problem from the same start: a swing-up with limits and the hopper; then all on one plot.

Run with    python demos/10_comparing_methods.py
"""

import mjslq

METHODS = ("auto", "slq", "newton", "trust-region", "pronto")


def main() -> None:
    for name in ("double_pendulum", "hopper"):
        problem = mjslq.problems.get(name)
        print(f"{name}\n  method         status            iterations   rollouts           cost   seconds")
        results = []
        for method in METHODS:
            result = mjslq.solve(problem, method, max_iterations=150)
            rollouts = sum(entry.evaluations for entry in result.log)
            print(
                f"  {method:13s}  {result.status.value:16s}  {result.iterations:10d}   {rollouts:8d}   "
                f"{result.cost:12.8g}   {result.seconds:7.2f}"
            )
            results.append(result)

    # The best one in the viewer, the others beside it: costs over iterations, in one plot.
    best, *others = sorted(results, key=lambda result: result.cost)
    mjslq.view(best, beside=others)


if __name__ == "__main__":
    main()
