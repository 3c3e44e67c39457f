"""A cart-pole under receding-horizon control, live in the browser: push it, drag its target, stop planner or plant.

Run with    python demos/live_cart_pole.py
"""

import mjslq


def pose(target, weights):
    """The swing-up to a place of the cart."""
    made = mjslq.problems.get("cart_pole", horizon=50, duration=2.0)
    upright = [target[0], 0.0, 0.0, 0.0]
    costs = [
        mjslq.costs.Control(weights["effort"]),
        mjslq.costs.State([5.0, 10.0, 0.5, 1.0], upright),
        mjslq.costs.State([50.0, 100.0, 5.0, 10.0], upright, "terminal"),
    ]
    return mjslq.Problem(made.dynamics, 50, made.x0, costs, name="cart_pole")


def main() -> None:
    target, weights = [0.0, 0.0, 0.0], {"effort": 0.01}
    mpc = mjslq.MPC(pose(target, weights), iterations=2)
    mjslq.live(mpc, pose=pose, target=target, weights=weights, push=5.0)


if __name__ == "__main__":
    main()
