"""Texts beside the robot: the summary of a result, of a solve at work, and of several results, as HTML."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

from mjslq.log import IterationLog
from mjslq.reports import in_force, limits
from mjslq.result import Result
from mjslq.unknowns import TIME
from mjslq.validation import Array

_FONT = "font-size:12px;line-height:1.55"
_GOOD, _FAIR, _BUSY = ("#1d7a4f", "#e3f4ea"), ("#94600b", "#fdf1dc"), ("#1f5aa8", "#e1ecfa")
"""Ink and paper of the label of a result's status."""


def short(number: float) -> str:
    """Return a number with four digits."""
    return f"{number:.4g}" if np.isfinite(number) else "not finite"


def _counted(array: Array, what: str) -> str:
    return f"{array.shape[1]} {what}" + ("" if array.shape[1] == 1 else "s")


def facts(result: Result) -> list[tuple[str, str]]:
    """Return what a summary tells of a result: (label, value)."""
    told = [
        ("method", result.method or "not recorded"),
        ("cost", short(result.cost)),
        ("iterations", str(result.iterations)),
        ("gradient norm", short(result.gradient_norm)),
        ("solve time", f"{short(result.seconds)} s"),
        *([("compiling", f"{short(result.compile_seconds)} s")] if result.compile_seconds > 0.0 else []),
        ("horizon", f"{result.trajectory.horizon} steps, {short(float(result.trajectory.times[-1]))} s"),
        ("size", f"{_counted(result.trajectory.X, 'state')}, {_counted(result.trajectory.U, 'control')}"),
    ]
    told[2:2] = [(name, short(value) + (" s" if name == TIME else "")) for name, value in result.unknowns.items()]
    if result.constraint_violation > 0.0:
        told.insert(4, ("violation", short(result.constraint_violation)))
    if at := limits.describe(result, brief=True):
        told.append(("at limits", at))
    if held := in_force.in_force(result):
        told.append(("in force", "; ".join(str(entry) for entry in held)))
    return told


def summary(result: Result) -> str:
    """Return the summary as HTML."""
    ink, paper = _GOOD if result.success else _FAIR
    status = result.status.value.replace("_", " ")
    note = "" if result.success else f'<div style="margin-top:8px;opacity:.75">{html.escape(result.message)}</div>'
    return _card(result.problem or "result", status, ink, paper, facts(result), note)


def solving(problem: str, method: str, entry: IterationLog | None, stopping: bool = False) -> str:
    """Return what is known of a solve at work, after its last iteration `entry`, as HTML."""
    told = [("method", method)]
    note = '<div style="margin-top:8px;opacity:.75">Finding the first direction; kernels may be compiling.</div>'
    if entry is not None:
        note = ""
        step = {"accepted": short(entry.alpha), "final": "none needed"}.get(entry.outcome, entry.outcome)
        told += [
            ("iteration", str(entry.iteration)),
            ("cost", short(entry.cost)),
            ("gradient norm", short(entry.gradient_norm)),
            ("step", step),
            ("damping", short(entry.multiplier)),
            *([("trust region", short(entry.radius))] if entry.radius > 0.0 else []),
            *([("violation", short(entry.violation))] if entry.violation > 0.0 else []),
            *([("at limits", str(entry.limited))] if entry.limited else []),
            ("time", f"{entry.seconds:.1f} s"),
        ]
    return _card(problem, "stopping" if stopping else "solving", *_BUSY, told, note)


def comparison(results: Sequence[tuple[str, str, Result]]) -> str:
    """Return a table of several results, (label, colour, result), as HTML."""
    best = min((result.cost for _, _, result in results), default=np.inf)
    rows = ""
    for label, color, result in results:
        weight = "font-weight:650" if result.cost == best else ""
        cells = (
            f'<span style="display:inline-block;width:10px;height:10px;border-radius:2px;background:{color};'
            f'margin-right:7px"></span>{html.escape(label)}',
            result.status.value.replace("_", " "),
            str(result.iterations),
            f"{result.seconds:.2g} s",
            f'<span style="{weight}">{short(result.cost)}</span>',
        )
        rows += "".join(
            f'<div style="{"" if place == 0 else "text-align:right;opacity:.8;"}white-space:nowrap;overflow:hidden;'
            f'text-overflow:ellipsis">{cell}</div>'
            for place, cell in enumerate(cells)
        )
    heads = "".join(
        f'<div style="opacity:.62;{"" if place == 0 else "text-align:right"}">{head}</div>'
        for place, head in enumerate(("", "status", "iter.", "time", "cost"))
    )
    titles = dict.fromkeys(result.problem or "result" for _, _, result in results)
    return (
        f'<div style="{_FONT};padding:10px 12px 4px"><div style="font-size:15px;font-weight:650;margin-bottom:6px">'
        f"{html.escape(', '.join(titles))}</div>"
        f'<div style="display:grid;grid-template-columns:minmax(0,1fr) repeat(4,auto);gap:1px 10px;'
        f'font-variant-numeric:tabular-nums">{heads}{rows}</div></div>'
    )


def _card(title: str, status: str, ink: str, paper: str, told: Sequence[tuple[str, str]], note: str) -> str:
    rows = "".join(
        f'<div style="opacity:.62">{label}</div><div style="text-align:right;font-variant-numeric:tabular-nums">'
        f"{html.escape(value)}</div>"
        for label, value in told
    )
    return (
        f'<div style="{_FONT};padding:10px 12px 4px">'
        '<div style="display:flex;justify-content:space-between;align-items:center;gap:8px;margin-bottom:6px">'
        f'<span style="font-size:15px;font-weight:650">{html.escape(title)}</span>'
        f'<span style="font-size:11px;font-weight:600;padding:1px 8px;border-radius:9px;white-space:nowrap;color:{ink};'
        f'background:{paper}">{status}</span></div>'
        f'<div style="display:grid;grid-template-columns:auto 1fr;gap:1px 10px">{rows}</div>{note}</div>'
    )
