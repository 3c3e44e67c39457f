"""Docstrings of the public names: every parameter and field, what is returned and raised, and an example that runs.

Functions have the sections of NumPy's convention. Methods may name their parameters in the text. Examples may take
`mjslq` and `np` as imported.
"""

import ast
import dataclasses
import doctest
import enum
import importlib
import inspect
import re
import textwrap

import numpy as np
import pytest

import mjslq
from mjslq import constraints, costs, problems, robots, simulation, starts
from mjslq.lq import square_root

PACKAGE_USE = {"CostTerm", "Constraint", "BoundConstraints", "bind_all", "read", "Start", "plant_of", "Plant"}
"""Names without an underscore that only the package uses."""
SECTIONS = re.compile(r"^(Parameters|Returns|Raises|Examples)\n-+\n", re.MULTILINE)
OWED = {"mjslq.view", "mjslq.watch"}
"""Names whose docstrings, or those of whose methods, are still to be written; to be taken out of here."""


def is_public(name, value, module):
    own = getattr(value, "__module__", None) == module.__name__
    return own and not name.startswith("_") and name not in PACKAGE_USE and callable(value)


def names_of(module):
    """Public classes and functions of a module, by name."""
    known = getattr(module, "__all__", None)
    return {
        f"{module.__name__}.{name}": value
        for name, value in vars(module).items()
        if (name in known if known else is_public(name, value, module)) and callable(value)
    }


NAMES = {
    f"mjslq.{name}": getattr(mjslq, name)
    for name in mjslq.__all__
    if inspect.isclass(getattr(mjslq, name)) or inspect.isfunction(getattr(mjslq, name))
}
for _module in (costs, constraints, simulation, starts, problems, robots):
    NAMES |= {name: value for name, value in names_of(_module).items() if value not in NAMES.values()}
NAMES = {name: value for name, value in NAMES.items() if name not in OWED}
FUNCTIONS = {name: value for name, value in NAMES.items() if inspect.isfunction(value)} | {
    "square_root.solve": square_root.solve
}
CLASSES = {name: value for name, value in NAMES.items() if inspect.isclass(value)}
METHODS = {
    f"{owner}.{name}": getattr(value, "__func__", value)
    for owner, kind in CLASSES.items()
    for name, value in vars(kind).items()
    if f"{owner}.{name}" not in OWED
    and (not name.startswith("_") or name == "__call__")
    and callable(getattr(value, "__func__", value))
}


def document(value):
    return inspect.getdoc(value) or ""


def section(text, title):
    """The lines of a section; none where it is not there."""
    parts = re.split(SECTIONS, text)
    return parts[parts.index(title) + 1] if title in parts[1::2] else ""


def documented(text):
    """Names in the section of the parameters."""
    entries = re.findall(r"^(\**\w+(?:, \**\w+)*)(?: : .*)?$", section(text, "Parameters"), re.MULTILINE)
    return [name.lstrip("*") for entry in entries for name in entry.split(", ")]


def options_in(text):
    """Names that stand on a line of their own, above an indented text."""
    lines = re.findall(r"^(\**\w+(?:, \**\w+)*)(?: : .*)?\n    \S", text, re.MULTILINE)
    return {name.lstrip("*") for line in lines for name in line.split(", ")}


def parameters(function):
    return [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_have_their_sections(name):
    function, text = FUNCTIONS[name], document(FUNCTIONS[name])
    assert sorted(documented(text)) == sorted(parameters(function))
    if parameters(function):
        assert section(text, "Raises")
    if inspect.signature(function).return_annotation != "None":
        assert section(text, "Returns")


@pytest.mark.parametrize("name", CLASSES)
def test_classes_document_their_fields_or_parameters(name):
    kind, text = CLASSES[name], document(CLASSES[name])
    if issubclass(kind, (enum.Enum, mjslq.Dynamics)) and "__init__" not in vars(kind):
        return
    if "__init__" in vars(kind) and not dataclasses.is_dataclass(kind):
        assert set(parameters(kind.__init__)) - {"scene", "followers", "name", "model"} <= options_in(text)
        return
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body
    for field, below in zip(body, [*body[1:], None], strict=True):
        if isinstance(field, ast.AnnAssign) and not field.target.id.startswith("_"):
            is_text = isinstance(below, ast.Expr) and isinstance(getattr(below.value, "value", None), str)
            assert is_text, f"{name}.{field.target.id} has no docstring"


@pytest.mark.parametrize("name", METHODS)
def test_methods_name_their_parameters(name):
    function, text = METHODS[name], document(METHODS[name])
    assert text
    if text.startswith("See `") or "; see `" in text or "see the class" in text.lower():
        return  # what another has in full
    missing = [name for name in parameters(function) if f"`{name}`" not in text and name not in documented(text)]
    assert not missing, f"{name} says nothing of {missing}"
    assert set(documented(text)) <= set(parameters(function))


@pytest.mark.parametrize("name", {**CLASSES, **FUNCTIONS})
def test_examples_are_true(name):
    value = {**CLASSES, **FUNCTIONS}[name]
    module = importlib.import_module(value.__module__)
    finder = doctest.DocTestFinder(recurse=False)
    found = finder.find(value, name, module, globs={"mjslq": mjslq, "np": np})
    tests = [test for test in found if test.examples]
    assert tests, f"{name} has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    said = []
    for test in tests:
        runner.run(test, out=said.append)
    assert runner.failures == 0, "".join(said)
