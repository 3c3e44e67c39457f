"""MuJoCo's muscles: how force and activation depend on length, velocity, control and activation.

Notation
--------
    L = r + (length - l) / L0, V = velocity / (L0 vmax)        in units of the optimal length L0
    gain = -F0 FL(L) FV(V)        FL: a hump of four parabolas, one at L = 1 and zero at lmin and lmax;
                                  FV: (V + 1)^2 while shortening, fvmax - (y - V)^2 / y with y = fvmax - 1 beyond
    bias = -F0 fpmax FP(L)        FP: a parabola from L = 1 on, a straight line from (1 + lmax) / 2 on
    da/dt = (u - a) / tau         tau = tau_act s while u > a, tau_deact / s otherwise, s = 1/2 + 3/2 a; a fifth-order
                                  step leads from one to the other when the muscle has a smoothing width

u, and a in s, are clamped to [0, 1]. (MuJoCo's documentation, "Muscles".)

At u = a without a smoothing width da/dt has a kink, where its derivatives are the means of the two sides; at the ends
of [0, 1] those towards the inside, as for all clamps: no control leads a resting muscle below zero. The second
derivative of FV at V = 0 is the mean of its two sides.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.forces.kinks import sign
from mjslq.dynamics.mujoco.inverse.spatial import compiled, inlined
from mjslq.dynamics.mujoco.inverse.table.columns import LENGTH_RANGE, MUSCLE_BIAS, MUSCLE_GAIN, MUSCLE_TIMES

_FORCE, _LMIN, _LMAX, _VMAX, _FPMAX, _FVMAX = 2, 4, 5, 6, 7, 8
_TINY = 1e-15


@inlined
def _optimal_length(prm, at):
    return max((prm[LENGTH_RANGE + 1] - prm[LENGTH_RANGE]) / max(prm[at + 1] - prm[at], _TINY), _TINY)


@compiled
def muscle_gain(prm, length, velocity):
    """Gain, and its derivatives by length, velocity, length and velocity, velocity twice."""
    at = MUSCLE_GAIN
    force, unit = prm[at + _FORCE], _optimal_length(prm, at)
    reach, slope = _hump(prm[at] + (length - prm[LENGTH_RANGE]) / unit, prm[at + _LMIN], prm[at + _LMAX])
    pace = 1.0 / max(unit * prm[at + _VMAX], _TINY)
    grip, by_v, by_vv = _yield(velocity * pace, prm[at + _FVMAX])
    held, steep = -force * reach, -force * slope / unit
    return held * grip, steep * grip, held * by_v * pace, steep * by_v * pace, held * by_vv * pace * pace


@inlined
def _hump(L, lmin, lmax):
    """FL and its derivative."""
    sign, end = (1.0, lmin) if L <= 1.0 else (-1.0, lmax)
    half = max(0.5 * abs(1.0 - end), _TINY)
    x = sign * (L - end) / half
    if x < 0.0:
        return 0.0, 0.0
    if x <= 1.0:
        return 0.5 * x * x, sign * x / half
    return 1.0 - 0.5 * (2.0 - x) * (2.0 - x), sign * (2.0 - x) / half


@inlined
def _yield(V, fvmax):
    """FV and its first two derivatives."""
    y = fvmax - 1.0
    if V == 0.0:
        return 1.0, 2.0 if y > 0.0 else 1.0, 1.0 - (1.0 / y if y > 0.0 else 0.0)
    if V < 0.0:
        left = max(V + 1.0, 0.0)
        return left * left, 2.0 * left, 2.0 if left > 0.0 else 0.0
    left = max(y - V, 0.0)
    if left == 0.0:
        return fvmax, 0.0, 0.0
    return fvmax - left * left / y, 2.0 * left / y, -2.0 / y


@compiled
def muscle_bias(prm, length):
    """Passive force, and its derivative by length."""
    at = MUSCLE_BIAS
    unit, half = _optimal_length(prm, at), max(0.5 * (prm[at + _LMAX] - 1.0), _TINY)
    x = (prm[at] + (length - prm[LENGTH_RANGE]) / unit - 1.0) / half
    force, slope = prm[at + _FORCE] * prm[at + _FPMAX], 1.0 / (half * unit)
    if x <= 0.0:
        return 0.0, 0.0
    if x <= 1.0:
        return -0.5 * force * x * x, -force * x * slope
    return -force * (x - 0.5), -force * slope


@compiled
def muscle_rate(prm, u, a):
    """da/dt, and its derivatives by u and a."""
    times, width = prm[MUSCLE_TIMES : MUSCLE_TIMES + 2], prm[MUSCLE_TIMES + 2]
    by_u = 1.0 if 0.0 <= u <= 1.0 else 0.0
    inside = 1.5 if 0.0 <= a <= 1.0 else 0.0
    error = min(max(u, 0.0), 1.0) - a
    s = 0.5 + 1.5 * min(max(a, 0.0), 1.0)
    share, steepness = 0.5 + 0.5 * sign(error), 0.0
    if width >= _TINY:
        x = min(max(error / width + 0.5, 0.0), 1.0)
        share, steepness = x * x * x * (x * (6.0 * x - 15.0) + 10.0), 30.0 * x * x * (1.0 - x) * (1.0 - x) / width
    rising, falling = times[0] * s, times[1] / s
    if error == 0.0 and width < _TINY:
        up, down = 1.0 / max(rising, _TINY), 1.0 / max(falling, _TINY)
        share = 1.0 if u <= 0.0 else (0.0 if u >= 1.0 else 0.5)
        return 0.0, share * up + (1.0 - share) * down, -share * down - (1.0 - share) * up
    tau = max(falling + (rising - falling) * share, _TINY)
    by_error = (1.0 - error / tau * (rising - falling) * steepness) / tau
    by_s = -error / (tau * tau) * (times[0] * share - falling / s * (1.0 - share))
    return error / tau, by_u * by_error, inside * by_s - by_error
