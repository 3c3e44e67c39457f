"""The trust region: Van der Pol's oscillator as in Table I of Fukushima and Yamamoto 1986, radii and decisions.

Run with    python demos/05_trust_region.py
"""

import mjslq


def main() -> None:
    problem = mjslq.problems.get("van_der_pol")
    result = mjslq.solve(problem, "trust-region")
    print(" it          cost   radius    ratio   multiplier   outcome")
    for entry in result.log:
        print(
            f"{entry.iteration:3d}   {entry.cost:11.8g}   {entry.radius:6.4g}   {entry.ratio:6.3f}   "
            f"{entry.multiplier:10.4g}   {entry.outcome}"
        )
    print(f"\n{result.status.value}: cost {result.cost:.8g}, |gradient| {result.gradient_norm:.1e}")
    for method in ("auto", "newton", "slq"):
        other = mjslq.solve(problem, method)
        print(f"{method:12s} {other.iterations:3d} iterations to {other.cost:.8g}")
    mjslq.view(result)


if __name__ == "__main__":
    main()
