"""A quadruped stands up with soft contacts; then the same policy on stiff ones, with what that changes.

Run with    python demos/08_quadruped.py
"""

import mjslq


def main() -> None:
    problem = mjslq.problems.get("solo12_stand")
    result = mjslq.solve(problem, verbose=1)
    print(f"solved with {result.contact}: feet sink {1e3 * result.penetration:.1f} mm")
    replay = result.replay(contact="stiff")
    print(f"with stiff contacts they sink {1e3 * replay.penetration:.1f} mm, and the base ends at a height of")
    print(f"{replay.trajectory.X[-1, 2]:.4f} m instead of {result.trajectory.X[-1, 2]:.4f} m")
    mjslq.view(result)


if __name__ == "__main__":
    main()
