"""The order of the house: no private module is imported across packages, nothing imports in circles or upwards."""

import ast
import importlib.util
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import mjslq

ROOT = Path(mjslq.__file__).parent
FILES = {
    ".".join(("mjslq", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in sorted(ROOT.rglob("*.py"))
}
"""Modules by name."""
GROUND = (
    "mjslq.dynamics",
    "mjslq.lq",
    "mjslq.costs",
    "mjslq.residuals",
    "mjslq.binding",
    "mjslq.losses",
    "mjslq.problem",
    "mjslq.bounds",
)
"""Rooms that everything stands on."""
ABOVE = ("mjslq.solvers", "mjslq.optimize", "mjslq.result", "mjslq.storage", "mjslq.starts", "mjslq.problems",
         "mjslq.reports", "mjslq.viewer", "mjslq.cli")  # fmt: skip
"""What they must not know of."""


def within(module, room):
    return module == room or module.startswith(room + ".")


def for_types_only(node):
    return isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")


def statements(body, *, deep):
    """Import statements, those under `if TYPE_CHECKING` excluded; `deep` with those inside of functions."""
    for node in body:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield node
        elif for_types_only(node):
            yield from statements(node.orelse, deep=deep)
        elif deep or not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            for field in ("body", "orelse", "finalbody", "handlers", "cases"):
                yield from statements(getattr(node, field, []), deep=deep)


def imported(module, *, deep=False):
    """Names that a module imports, of this package: modules, and names in modules as module.name."""
    is_package = FILES[module].name == "__init__.py"
    for node in statements(ast.parse(FILES[module].read_text()).body, deep=deep):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if within(alias.name, "mjslq"))
            continue
        base = node.module or ""
        if node.level:
            dotted = "." * node.level + base
            base = importlib.util.resolve_name(dotted, module if is_package else module.rpartition(".")[0])
        if within(base, "mjslq"):
            yield from (f"{base}.{alias.name}" for alias in node.names)


def module_of(name):
    """The module that an imported name is, or stands in."""
    while name not in FILES:
        name = name.rpartition(".")[0]
    return name


def modules_imported(module, *, deep=False):
    return {module_of(name) for name in imported(module, deep=deep)} - {module}


def test_the_whole_package_is_looked_at():
    assert len(FILES) > 60 and {"mjslq", "mjslq.lq.riccati", "mjslq.solvers.loop", "mjslq.viewer.scene"} <= set(FILES)
    assert "mjslq.lq.box" in modules_imported("mjslq.bounds")
    assert "mjslq.storage" in modules_imported("mjslq.result", deep=True) - modules_imported("mjslq.result")


@pytest.mark.parametrize("module", FILES)
def test_no_private_name_is_imported_across_packages(module):
    """A leading underscore is for the package itself; there is no private module any more."""
    assert not any(part.startswith("_") and part not in ("__init__", "__main__") for part in module.split("."))
    package = module if FILES[module].name == "__init__.py" else module.rpartition(".")[0]
    for name in imported(module, deep=True):
        private = [part for part in name.split(".") if part.startswith("_") and not part.startswith("__")]
        assert not private or within(name, package), f"{module} imports {name}"


def test_modules_import_each_other_in_one_direction():
    """Importing a package runs its __init__, which counts as imported, too."""
    graph = {}
    for module in FILES:
        found = modules_imported(module)
        for name in list(found):
            parents = {name.rsplit(".", i)[0] for i in range(1, name.count(".") + 1)}
            found |= {parent for parent in parents if parent != "mjslq" and not within(module, parent)}
        graph[module] = found
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail("modules import each other: " + " -> ".join(error.args[1]))


@pytest.mark.parametrize("module", [name for name in FILES if any(within(name, room) for room in GROUND)])
def test_the_ground_knows_nothing_of_what_stands_on_it(module):
    for name in imported(module, deep=True):
        assert not any(within(module_of(name), room) for room in ABOVE), f"{module} imports {name}"


@pytest.mark.parametrize(
    "room, below",
    [
        ("mjslq.lq", ("mjslq.lq", "mjslq.native", "mjslq.validation")),
        ("mjslq.policy", ("mjslq.manifold", "mjslq.policy_file", "mjslq.trajectory", "mjslq.validation")),
        ("mjslq.trajectory", ("mjslq.validation",)),
        ("mjslq.status", ()),
        ("mjslq.log", ()),
    ],
)
def test_what_the_lowest_rooms_stand_on(room, below):
    for module in FILES:
        if within(module, room):
            for name in modules_imported(module, deep=True):
                assert any(within(name, floor) for floor in below), f"{module} imports {name}"


def test_solvers_know_no_engine_by_name():
    for module in FILES:
        if within(module, "mjslq.solvers"):
            for name in modules_imported(module, deep=True):
                engine = [
                    part for part in ("mujoco", "pinocchio", "function") if within(name, f"mjslq.dynamics.{part}")
                ]
                assert not engine, f"{module} imports {name}"


def test_files_are_short():
    for module, path in FILES.items():
        assert len(path.read_text().splitlines()) <= 420, module
