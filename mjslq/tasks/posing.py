"""A task file's costs, constraints, limits and start as a `Problem`: names are looked up, tables become arrays."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq import constraints, costs, starts
from mjslq.bounds import Bounds
from mjslq.constraints import Constraint
from mjslq.costs import CostTerm
from mjslq.knots import TIME_TOLERANCE, When
from mjslq.problem import Problem
from mjslq.tasks import schema
from mjslq.tasks.clips import Clips, tracked
from mjslq.tasks.engines import distance_sensor, output_of
from mjslq.tasks.reading import Source, TaskError
from mjslq.validation import Array, choose

if TYPE_CHECKING:
    from mjslq.clips import Clip
    from mjslq.dynamics.mujoco import MujocoDynamics
    from mjslq.dynamics.pinocchio import PinocchioDynamics

_LIST = re.compile(r"^(costs|constraints)\[(\d+)\] \([^)]*\): (.*)$", re.DOTALL)
"""How `Problem` names the term that does not fit."""
_FREE = re.compile(r"^(free_time|free_parameters)(?:: | )(.*)$", re.DOTALL)


@dataclass(frozen=True)
class Poser:
    """What it takes to pose the problem of a task file."""

    task: schema.TaskFile
    dynamics: MujocoDynamics | PinocchioDynamics
    source: Source
    clips: Clips = field(default_factory=dict)

    def problem(self) -> Problem:
        """The problem. Raises `TaskError`."""
        x0, task = self._x0(), self.task
        N = self.horizon
        by_table = [self._at(("costs", i), self._costs, cost, x0) for i, cost in enumerate(self.task.costs)]
        terms = [term for found in by_table for term in found]
        tables = [i for i, found in enumerate(by_table) for _ in found]
        held = [self._at(("constraints", i), self._constraint, c) for i, c in enumerate(self.task.constraints)]
        with self.source.at("bounds", "u"):
            bounds = self._bounds()
        try:
            problem = Problem(
                self.dynamics, N, x0, terms, constraints=held, bounds=bounds, U0=self._controls(),
                free_time=None if task.free_time is None else (task.free_time[0], task.free_time[1]),
                free_parameters={name: (low, high) for name, (low, high) in (task.free_parameters or {}).items()},
                name=self.task.name or self.source.name.rsplit(".", 1)[0],
            )  # fmt: skip
        except TaskError:
            raise
        except ValueError as error:
            raise TaskError(self._placed(str(error), tables)) from None
        return problem

    def guess(self, problem: Problem) -> Array | None:
        """Controls (N, nu) or states (N + 1, nx) to start from, where these depend on the problem."""
        if self.task.start.controls == "clip":
            with self.source.at("start", "controls"):
                clip, timing = self._starting_clip()
                return clip.guess(problem, *timing)
        return starts.hold(problem) if self.task.start.controls == "hold" else None

    def _at(self, place: tuple[str | int, ...], make: Any, *given: Any) -> Any:
        with self.source.at(*place):
            return make(*given)

    def _placed(self, sentence: str, tables: Sequence[int]) -> str:
        """A complaint of `Problem`'s, with the line of the table that it is about, for the table of each cost term."""
        match, free = _LIST.match(sentence), _FREE.match(sentence)
        if free is not None:
            return self.source.sentence((free[1],), free[2])
        if match is None:
            return f"{self.source.name}: {sentence}"
        i = int(match[2])
        return self.source.sentence((match[1], tables[i] if match[1] == "costs" else i), match[3])

    @cached_property
    def horizon(self) -> int:
        """Number of steps N."""
        task, dt = self.task, float(np.ravel(self.dynamics.dt)[0])
        if (task.horizon is None) == (task.duration is None):
            raise TaskError(self.source.sentence((), "give horizon (steps) or duration (seconds), one of the two"))
        if task.duration is None:
            assert task.horizon is not None
            return task.horizon
        N = round(task.duration / dt) if np.isfinite(task.duration) else 0
        if N < 1 or abs(N * dt - task.duration) > 1e-6 * task.duration:
            what = f"must be a multiple of the step, {dt:g} s, got {task.duration:g}"
            raise TaskError(self.source.sentence(("duration",), what))
        return N

    def _x0(self) -> Array:
        """The initial state: the keyframe's, or the model's, with entries replaced."""
        start, x0 = self.task.start, self._resting()
        for key, ending in (("positions", ""), ("velocities", ".vel")):
            for name, value in (getattr(start, key) or {}).items():
                with self.source.at("start", key, name):
                    x0[self._entry(name, ending)] = value
        return x0

    def _starting_clip(self) -> tuple[Clip, tuple[Any, ...]]:
        """The clip of the start, and its offset, stretch and what is beyond: those of its first cost."""
        file = self.task.start.clip
        if file is None:
            raise ValueError("is 'clip', but start has no clip")
        followed = [cost for cost in self.task.costs if isinstance(cost, schema.ClipCost) and cost.file == file]
        timing = [(cost.offset, cost.stretch, cost.beyond) for cost in followed]
        return self.clips[file], timing[0] if timing else ()

    def _resting(self) -> Array:
        if self.task.start.clip is not None:
            with self.source.at("start", "clip"):
                if self.task.start.keyframe is not None:
                    raise ValueError("start has a keyframe, too; give one of them")
                clip, timing = self._starting_clip()
                return clip.states(self.dynamics, 0.0, *timing)
        if (name := self.task.start.keyframe) is not None:
            with self.source.at("start", "keyframe"):
                return np.array(self._keyframes("keyframe")(name))
        return np.array(self.dynamics.initial_state)

    def _keyframes(self, method: str) -> Any:
        found = getattr(self.dynamics, method, None)
        if found is None:
            raise ValueError(f"{type(self.dynamics).__name__} has no keyframes; give positions by name")
        return found

    def _controls(self) -> Array | None:
        """The first controls, one for all steps."""
        given = self.task.start.controls
        with self.source.at("start", "controls"):
            if given == "keyframe":
                if self.task.start.keyframe is None:
                    raise ValueError("is 'keyframe', but start has no keyframe")
                return np.array(self._keyframes("keyframe_control")(self.task.start.keyframe))
            if isinstance(given, str):
                return None
            if len(given) != self.dynamics.nu:
                names = ", ".join(self.dynamics.control_names)
                raise ValueError(f"must have {self.dynamics.nu} numbers, for {names}; got {len(given)}")
            return np.array(given)

    def _entry(self, name: str, ending: str = "") -> int:
        """Index in x of a position, or with an ending of a velocity."""
        names, nq = list(self.dynamics.state_names), self.dynamics.nx - self.dynamics.ndx + self.dynamics.nv
        positions, velocities = names[:nq], names[nq : nq + self.dynamics.nv]
        if not ending:
            return positions.index(choose("position", name, positions))
        given = name if name in velocities else name + ending
        if given not in velocities:
            choose("velocity", name, [v.removesuffix(ending) for v in velocities])
        return nq + velocities.index(given)

    @property
    def _joints(self) -> list[str]:
        """Joints with one axis."""
        names, nq = self.dynamics.state_names, self.dynamics.nx - self.dynamics.ndx + self.dynamics.nv
        return [name for name in names[:nq] if f"{name}.vel" in names[nq:]]

    def _direction(self, joint: str, of: schema.Of) -> tuple[int, int]:
        """Index in x, and in dx, of a joint with one axis."""
        names, nv = list(self.dynamics.state_names), self.dynamics.nv
        nq = self.dynamics.nx - self.dynamics.ndx + nv
        dof = names[nq : nq + nv].index(choose("joint with one axis", joint, self._joints) + ".vel")
        return (names.index(joint), dof) if of == "position" else (nq + dof, nv + dof)

    def _costs(self, cost: schema.Cost, x0: Array) -> list[CostTerm]:
        """The terms of a table: several for a clip."""
        if not isinstance(cost, schema.ClipCost):
            return [self._cost(cost, x0)]
        return list(tracked(cost, self.clips).costs(
            self.dynamics, cost.weights, loss=cost.loss, width=cost.width, when=self._when(cost.when),
            terminal=cost.terminal, offset=cost.offset, stretch=cost.stretch, beyond=cost.beyond,
        ))  # fmt: skip

    def _cost(self, cost: schema.OneCost, x0: Array) -> CostTerm:
        if isinstance(cost, schema.TimeCost):
            return costs.Time(cost.weight)
        loss: dict[str, Any] = {"loss": cost.loss, "width": cost.width}
        when = self._when(cost.when)
        if isinstance(cost, schema.ControlCost):
            names = self.dynamics.control_names
            weight, target = (_spread("control", given, names) for given in (cost.weight, cost.target))
            return costs.Control(weight, target, when, **loss)
        if isinstance(cost, schema.JointsCost):
            return self._joints_cost(cost, x0, when, loss)
        terminal = cost.terminal_weight
        if isinstance(cost, schema.VelocitiesCost):
            return self._velocities_cost(cost, when, loss)
        if isinstance(cost, schema.StateCost):
            goal: Any = x0 if cost.target == "start" else cost.target
            if isinstance(goal, dict):
                goal = self._replaced(x0, goal)
            last = self._state_weight(terminal)
            return costs.State(self._state_weight(cost.weight), goal, when, terminal_weight=last, **loss)
        if isinstance(cost.weight, dict) or isinstance(terminal, dict):
            raise ValueError("the weight of a reading must be a number, a list or a matrix: its entries have no names")
        name = output_of(self.task, cost) if isinstance(cost, schema.FrameCost) else cost.name
        return costs.Sensor(name, cost.target, cost.weight, when, terminal_weight=terminal, **loss)

    def _joints_cost(self, cost: schema.JointsCost, x0: Array, when: When, loss: dict[str, Any]) -> CostTerm:
        """A diagonal weight on the joints' directions."""
        asked: Mapping[str, float] = {} if cost.target == "start" else cost.target
        joints = self._joints if cost.target == "start" else list(asked)
        target, places = x0.copy(), {joint: self._direction(joint, cost.of) for joint in joints}
        for joint in asked:
            target[places[joint][0]] = asked[joint]

        def diagonal(given: float | Mapping[str, float]) -> Array:
            weights = _spread("joint with a target", given, list(places))
            found = np.zeros(self.dynamics.ndx)
            for (_, direction), weight in zip(places.values(), np.broadcast_to(weights, len(places)), strict=True):
                found[direction] = weight
            return found

        last = None if cost.terminal_weight is None else diagonal(cost.terminal_weight)
        return costs.State(diagonal(cost.weight), target, when, terminal_weight=last, **loss)

    def _velocities_cost(self, cost: schema.VelocitiesCost, when: When, loss: dict[str, Any]) -> CostTerm:
        """A diagonal weight on all velocities, or on those that a table names."""
        dynamics, nv = self.dynamics, self.dynamics.nv
        names = [name.removesuffix(".vel") for name in dynamics.state_names[dynamics.nx - dynamics.ndx + nv :][:nv]]

        def diagonal(given: float | Mapping[str, float]) -> Array:
            found = np.zeros(dynamics.ndx)
            found[nv : 2 * nv] = _spread("velocity", given, names)
            return found

        last = None if cost.terminal_weight is None else diagonal(cost.terminal_weight)
        return costs.State(diagonal(cost.weight), dynamics.initial_state, when, terminal_weight=last, **loss)

    def _when(self, given: Any) -> When:
        """`when` as costs and constraints take it: the knots of a window, both ends included."""
        if not isinstance(given, schema.Window):
            return given
        first, last, N = given.first, given.last, self.horizon
        if isinstance(first, int) and isinstance(last, int):
            knots = range(first, min(last, N) + 1)
        else:
            times = np.concatenate([[0.0], np.cumsum(self.dynamics.steps(N))])
            slack = TIME_TOLERANCE * times[-1]
            knots = np.flatnonzero((times >= first - slack) & (times <= last + slack))  # type: ignore[assignment]
        if not len(knots):
            raise ValueError(f"the window from {first:g} to {last:g} has no knot in it; knots are 0 to {N}")
        return [int(n) for n in knots]

    def _state_weight(self, given: Any) -> Any:
        """A weight by joint: "hip" for its position, "hip.vel" for its velocity."""
        if not isinstance(given, dict):
            return given
        found = np.zeros(self.dynamics.ndx)
        for name, weight in given.items():
            joint = name.removesuffix(".vel")
            found[self._direction(joint, "position" if joint == name else "velocity")[1]] = weight
        return found

    def _replaced(self, x0: Array, entries: Mapping[str, float]) -> Array:
        x, names = x0.copy(), list(self.dynamics.state_names)
        for name, value in entries.items():
            x[names.index(choose("entry of the state", name, names))] = value
        return x

    def _constraint(self, given: schema.Constraint) -> Constraint:
        if isinstance(given, schema.ControlConstraint):
            lower, upper = _sides("control", given.limits, self.dynamics.control_names)
            return constraints.Control(lower, upper, name=given.name)
        when = self._when(given.when)
        if isinstance(given, schema.JointsConstraint):
            lower, upper = self._joint_limits(given)
            kind = {"position": "joints", "velocity": "speeds"}[given.of]
            return constraints.State(lower, upper, when, name=given.name or kind)
        if isinstance(given, schema.DistanceConstraint):
            sensor = distance_sensor(*given.between)
            return constraints.Sensor(sensor, given.lower, None, when, name=given.name)
        sensor = given.sensor if isinstance(given, schema.SensorConstraint) else output_of(self.task, given)
        return constraints.Sensor(sensor, given.lower, given.upper, when, name=given.name)

    def _joint_limits(self, given: schema.JointsConstraint) -> tuple[Array, Array]:
        limits = given.limits
        if limits == "model":
            if given.of == "velocity":
                raise ValueError("limits of velocities are not part of models; give them as a table by joint")
            limits = self._ranges()
        lower, upper = np.full(self.dynamics.nx, -np.inf), np.full(self.dynamics.nx, np.inf)
        for joint, (low, high) in limits.items():
            entry, _ = self._direction(joint, given.of)
            lower[entry], upper[entry] = low + given.margin, high - given.margin
            if not low <= high:
                raise ValueError(f"limits of {joint!r} must be [lower, upper] with lower <= upper, got {[low, high]}")
            if lower[entry] > upper[entry]:
                raise ValueError(f"a margin of {given.margin:g} leaves nothing of {joint!r}, {low:g} to {high:g}")
        return lower, upper

    def _ranges(self) -> dict[str, list[float]]:
        """The ranges of the model's joints."""
        found = self.dynamics.joint_ranges
        if not found:
            raise ValueError("the model gives its joints no ranges; give limits as a table by joint")
        return {name: list(limits) for name, limits in found.items()}

    def _bounds(self) -> Bounds:
        given = self.task.bounds.u
        if isinstance(given, dict):
            low, high = np.array(self.dynamics.control_limits).T
            lower, upper = _sides("control", given, self.dynamics.control_names, low, high)
            return Bounds(u=(lower, upper))
        return Bounds(u="model" if given == "model" else None)


def _sides(
    kind: str, limits: Mapping[str, Sequence[float]], names: Sequence[str], low: Any = -np.inf, high: Any = np.inf
) -> tuple[Array, Array]:
    """Lower and upper limits by name; `low` and `high` for the others."""
    lower, upper = (np.array(np.broadcast_to(side, len(names)), dtype=np.float64) for side in (low, high))
    for name, (a, b) in limits.items():
        i = list(names).index(choose(kind, name, names))
        lower[i], upper[i] = a, b
    return lower, upper


def _spread(kind: str, given: Any, names: Sequence[str]) -> Any:
    """A table by name as a list over all names, zero for those that it leaves out; anything else as it is."""
    if not isinstance(given, dict):
        return given
    found = np.zeros(len(names))
    for name, value in given.items():
        found[list(names).index(choose(kind, name, names))] = value
    return found
