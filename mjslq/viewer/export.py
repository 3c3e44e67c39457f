"""`export_html`: a result as one HTML file that plays from disk, without a network and without Python."""

from __future__ import annotations

import html
import json
import math
import os
from importlib import resources
from typing import Any

import numpy as np
import viser

from mjslq.files import atomic_write
from mjslq.reports import limits
from mjslq.reports.units import model_from_mjb
from mjslq.result import Result
from mjslq.validation import Array, flag
from mjslq.viewer import panels, series, simplify
from mjslq.viewer.scene import SceneView, quiet

_FRAME_RATE, _MOST_FRAMES = 50.0, 1500
_REST = 0.7  # at the end, before the motion starts over [s]
_POINTS = 1200  # of a curve, at most about
_ASPECT = 1.25  # of the part of a usual window that shows the robot


def export_html(result: Result, path: str | os.PathLike[str], dark: bool = False) -> None:
    """Write `result` to one HTML file: the motion with its plots and a summary, or only these without a scene.

    `dark` makes the page dark. Meshes are drawn with fewer triangles, to within a pixel; see `simplify`.
    Raises ValueError when `result` is something else, its scene cannot be read, or the file cannot be written.
    """
    if not isinstance(result, Result):
        raise ValueError(f"only a Result of mjslq.solve or mjslq.load can be exported, got {type(result).__name__}")
    page = _page(result, flag("dark", dark))
    with atomic_write(path) as stream:
        stream.write(page.encode())


def _page(result: Result, dark: bool) -> str:
    model = None if result.scene is None else model_from_mjb(result.scene.model)
    scene = ""
    if result.scene is not None:
        recording = html.escape(_recording(result, dark), quote=True)
        scene = f'<iframe id="scene" title="The motion" srcdoc="{recording}"></iframe>'
    told = "".join(f"<div><dt>{name}</dt><dd>{html.escape(value)}</dd></div>" for name, value in panels.facts(result))
    parts = {
        "@TITLE@": html.escape(result.problem or "result"),
        "@THEME@": "dark" if dark else "light",
        "@STATUS@": html.escape(result.status.value.replace("_", " ")),
        "@STATUS_CLASS@": "good" if result.success else "fair",
        "@MESSAGE@": "" if result.success else f'<p class="message">{html.escape(result.message)}</p>',
        "@FACTS@": told,
        "@MODE@": "with-scene" if scene else "plots-only",
        "@DATA@": json.dumps(_data(result, model), allow_nan=False, separators=(",", ":")).replace("</", "<\\/"),
        "@SCENE@": scene,
    }
    page = resources.files("mjslq.viewer").joinpath("page.html").read_text(encoding="utf-8")
    for mark, text in parts.items():
        page = page.replace(mark, text)
    return page


def _recording(result: Result, dark: bool) -> str:
    """Return Viser's own page, with the motion recorded in it."""
    assert result.scene is not None
    with quiet():
        server = viser.ViserServer("127.0.0.1", label="mjslq", verbose=False)
    try:
        cell = simplify.cell_of(model_from_mjb(result.scene.model))
        view = SceneView(server, result.scene, result.trajectory, _ASPECT, dark=dark, contact=result.contact, cell=cell)
        duration = float(result.trajectory.times[-1])
        frames = int(np.clip(math.ceil(duration * _FRAME_RATE), 2, _MOST_FRAMES))
        recorder = server.get_scene_serializer()
        for n in range(1, frames + 1):
            recorder.insert_sleep(duration / frames)
            view.show(duration * n / frames)
        recorder.insert_sleep(_REST)
        return str(recorder.as_html(dark))
    finally:
        with quiet():
            server.stop()


def _data(result: Result, model: Any) -> dict[str, Any]:
    """Return what the page's script draws, in JSON's types."""
    kinds = []
    for title, kind in series.KINDS:
        groups = [_group(result, group) for group in series.groups(result, kind, model)]
        if groups:
            kinds.append({"title": title, "groups": groups})
    iterations, costs = series.costs(result.log)
    return {
        "duration": float(result.trajectory.times[-1]),
        "rest": _REST,
        "colors": series.COLORS,
        "kinds": kinds,
        "cost": {"x": iterations.tolist(), "y": _numbers(costs)},
    }


def _group(result: Result, group: series.Group) -> dict[str, Any]:
    trajectory = result.trajectory
    times, values = series.curves(trajectory, group)
    found = series.limits(result, trajectory, group)
    keep = series.thinning(values, _POINTS, None if found is None else found.active)
    told: dict[str, Any] = {
        "title": group.title,
        "unit": group.unit,
        "labels": group.labels,
        "x": _numbers(times[keep]),
        "y": [_numbers(column) for column in values[keep].T],
        "lines": [],
        "bars": [],
    }
    if found is not None:
        lines = found.lines()
        told["range"] = series.range_with_limits(values, [line for line, _ in lines])
        told["lines"] = [{"y": _numbers(line[keep]), "curve": curve} for line, curve in lines]
        steps = found.active[::2]  # curves give each step at both its ends
        if not group.held:  # and others at the knots
            steps = found.active[:-1] | found.active[1:]
        bars = [{"curve": i, "spans": limits.spans(column, trajectory.times)} for i, column in enumerate(steps.T)]
        told["bars"] = [bar for bar in bars if bar["spans"]]
    return told


def _numbers(values: Array) -> list[float]:
    return [float(f"{value:.6g}") for value in values]
