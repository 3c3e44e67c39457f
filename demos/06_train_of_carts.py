"""A train of carts with pendulums: closed-loop first-order steps beside second-order ones, as the train grows.

Run with    python demos/06_train_of_carts.py
"""

import time

import mjslq


def main() -> None:
    # dJ/dU of the controls alone means nothing here: within a second the pendulums turn rounding errors into falls, so
    # that a column of 1e12 for `auto` is no fault. The methods over curves measure it under feedback.
    print("carts   method      iterations          cost   |gradient|   ms an iteration")
    shown = None
    for carts in (1, 2, 4):
        problem = mjslq.problems.get("cart_train", carts=carts, theta=30.0)
        for method in ("gopronto", "pronto", "auto"):
            mjslq.solve(problem, method, max_iterations=1)  # compiles
            start = time.perf_counter()
            result = mjslq.solve(problem, method)
            each = 1e3 * (time.perf_counter() - start) / max(result.iterations, 1)
            print(
                f"{carts:5d}   {method:10s}  {result.iterations:10d}   {result.cost:11.7g}   "
                f"{result.gradient_norm:10.1e}   {each:15.1f}"
            )
            shown = result
    mjslq.view(shown)


if __name__ == "__main__":
    main()
