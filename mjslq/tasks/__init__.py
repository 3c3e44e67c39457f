"""Tasks in TOML files: model, horizon, start, costs, constraints and method, without a line of Python."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mjslq.tasks.task import Task as Task
    from mjslq.tasks.task import load_task as load_task

__all__ = ["Task", "load_task"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'mjslq.tasks' has no attribute {name!r}")
    from mjslq.tasks import task

    return getattr(task, name)
