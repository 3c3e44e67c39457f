"""Constraints: a particle before a wall, with its multipliers, and a vehicle that enters the atmosphere within 5 g.

Run with    python demos/07_constraints.py
"""

import numpy as np

import mjslq


def main() -> None:
    wall = mjslq.problems.get("bryson_denham")
    result = mjslq.solve(wall)
    print(f"Bryson and Denham: cost {result.cost:.6f} (exactly 4.4444 as the steps become short)")
    print(f"largest violation {result.constraint_violation:.1e}; multipliers where they are not zero:")
    for name, knots in result.knots.items():
        for knot, values in zip(knots, result.multipliers[name], strict=True):
            if values.any():
                print(f"    {name} at knot {knot}: {np.round(values, 6)}")

    entry = mjslq.problems.get("reentry")
    landed = mjslq.solve(entry)
    print(f"\nre-entry: {landed.status.value} after {landed.iterations} iterations")
    print(mjslq.explain(landed))
    mjslq.view(landed)


if __name__ == "__main__":
    main()
