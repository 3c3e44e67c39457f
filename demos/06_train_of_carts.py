"""A train of carts with pendulums: closed-loop first-order steps beside second-order ones, as the train grows.

Run with    python demos/06_train_of_carts.py
"""

import time

import mjslq

CASES = (("gopronto", {}), ("pronto", {}), ("auto", {}))


def main() -> None:
    print("carts   method      iterations          cost   |gradient|   ms an iteration")
    shown = None
    for carts in (1, 2, 4):
        problem = mjslq.problems.get("cart_train", carts=carts, theta=30.0)
        for method, options in CASES:
            mjslq.solve(problem, method, max_iterations=1, **options)  # compiles
            start = time.perf_counter()
            result = mjslq.solve(problem, method, **options)
            each = 1e3 * (time.perf_counter() - start) / max(result.iterations, 1)
            print(
                f"{carts:5d}   {method:10s}  {result.iterations:10d}   {result.cost:11.7g}   "
                f"{result.gradient_norm:10.1e}   {each:15.1f}"
            )
            shown = result
    mjslq.view(shown)


if __name__ == "__main__":
    main()
