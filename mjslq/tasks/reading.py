"""Reading a task file: TOML text to checked records, and what does not fit to one sentence with its line.

my_task.toml, line 14, costs[1].weight: must be a number or a table of numbers by name, got 'high'
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from mjslq.tasks.lines import Place, line_at, lines_of
from mjslq.tasks.schema import Says, TaskFile
from mjslq.validation import choose, path_of

_KINDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", dict: "a table"}


@dataclass(frozen=True)
class Source:
    """A task file's name and the lines of its keys, for messages."""

    name: str
    lines: Mapping[Place, int]

    def sentence(self, place: Sequence[str | int], what: str) -> str:
        """`what` with the file, the line and the key that it is about."""
        line = line_at(self.lines, place)
        parts = [self.name if line is None else f"{self.name}, line {line}", _key(place)]
        return f"{', '.join(part for part in parts if part)}: {what}"

    @contextmanager
    def at(self, *place: str | int) -> Iterator[None]:
        """A context whose ValueErrors are told of this place, unless they name one already."""
        try:
            yield
        except TaskError:
            raise
        except ValueError as error:
            raise TaskError(self.sentence(place, str(error))) from None


class TaskError(ValueError):
    """A sentence about a task file, its line and key included."""


def read(path: str | Path) -> tuple[TaskFile, Source]:
    """Read and check a task file. Raises `TaskError`, one sentence, where it cannot be read or does not fit."""
    file = path_of("path", path).expanduser()
    if not file.is_file():
        kind = "is a folder" if file.is_dir() else "does not exist"
        raise TaskError(f"task file {str(path)!r} {kind}; `mjslq new MODEL` writes one to begin with")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise TaskError(f"{file.name} is no text file") from None
    except OSError as error:
        raise TaskError(f"cannot read {file}: {error.strerror or error}") from None
    return parse(text, file.name)


def parse(text: str, name: str = "the task") -> tuple[TaskFile, Source]:
    """Check the text of a task file called `name`; see `read`."""
    try:
        data = tomllib.loads(text)
    except ValueError as error:  # numbers of thousands of digits are another kind than `TOMLDecodeError`
        raise TaskError(f"{name} is no valid TOML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise TaskError(f"{name} is no valid TOML: it is nested too deeply") from None
    source = Source(name, lines_of(text))
    try:
        return TaskFile.model_validate(data), source
    except ValidationError as error:
        told = [_told(found, data) for found in error.errors(include_url=False)]
    last = len(text) + 1  # what is missing comes after what is there
    first, what = min(told, key=lambda one: (line_at(source.lines, one[0]) or last, len(one[0])))
    elsewhere = len({place for place, _ in told if place[: len(first)] != first})
    rest = f" (and {elsewhere} more)" if elsewhere else ""
    raise TaskError(source.sentence(first, what) + rest)


def _told(error: Any, data: Any) -> tuple[Place, str]:
    """Where in the file an error of the records is, and what to say about it."""
    place, field, owner = _walk(error["loc"], data)
    if error["type"] == "extra_forbidden":
        known = [] if owner is None else _keys(owner)
        return place, _unknown(str(place[-1]), known)
    if error["type"] == "union_tag_not_found":
        return place, f"kind is missing; there are: {', '.join(_tags(field))}"
    if error["type"] == "union_tag_invalid":
        return (*place, "kind"), _unknown(str(error["ctx"]["tag"]), _tags(field), "kind")
    words = "given" if field is None else expected(field)
    if error["type"] == "missing":
        return place, f"is missing; it must be {words}"
    return place, f"must be {words}, got {_short(_value(data, place))}"


def _walk(loc: Sequence[Any], data: Any) -> tuple[Place, FieldInfo | None, type[BaseModel] | None]:
    """The place of an error in the data, the field of the records there, and the record that the field is in.

    The records name the branches of unions among the keys; what is not in the data is such a name, but for a key that
    is missing at the end.
    """
    record: type[BaseModel] | None = TaskFile
    owner: type[BaseModel] | None = None
    field: FieldInfo | None = None
    place: Place = ()
    for i, part in enumerate(loc):
        fields = {} if record is None else _by_key(record)
        if isinstance(data, dict) and (part in data or (part in fields and i == len(loc) - 1)):
            owner, place = record, (*place, part)
            found = fields.get(part)
            field, data = (found or field), data.get(part)
            record = None if found is None else _record_of(found, data)
        elif isinstance(data, list) and isinstance(part, int) and field is not None and part < len(data):
            if not _records(field):
                break  # entries of a list of numbers: the list is what is wrong
            place, data, record = (*place, part), data[part], _record_of(field, data[part])
    return place, field, owner


def _record_of(field: FieldInfo, data: Any) -> type[BaseModel] | None:
    """The record among the kinds of a field that fits a table; None where there is none."""
    records = _records(field)
    if len(records) > 1 and isinstance(data, dict):
        records = [kind for kind in records if data.get("kind") in get_args(kind.model_fields["kind"].annotation)]
    return records[0] if records else None


def _records(field: FieldInfo) -> list[type[BaseModel]]:
    """The records among the kinds of a field."""
    return [kind for kind in _flat(field.annotation) if isinstance(kind, type) and issubclass(kind, BaseModel)]


def _flat(annotation: Any) -> Iterator[Any]:
    """The plain types of an annotation."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _flat(get_args(annotation)[0])
    elif origin in (Union, UnionType, list):
        for part in get_args(annotation):
            yield from _flat(part)
    else:
        yield annotation


def expected(field: FieldInfo) -> str:
    """What a field has to be, in words."""
    for metadata in (*field.metadata, *_metadata(field.annotation)):
        if isinstance(metadata, Says):
            return metadata.words
    kinds = [kind for kind in _flat(field.annotation) if kind is not NoneType]
    words = []
    for kind in kinds:
        if get_origin(kind) is Literal:
            words += [f'"{value}"' for value in get_args(kind)]
        elif isinstance(kind, type) and issubclass(kind, BaseModel):
            words.append("a table")
        else:
            words.append(_KINDS.get(get_origin(kind) or kind, "something else"))
    return " or ".join(dict.fromkeys(words))


def _metadata(annotation: Any) -> Iterator[Any]:
    if get_origin(annotation) is Annotated:
        yield from get_args(annotation)[1:]
    elif get_origin(annotation) in (Union, UnionType):
        for part in get_args(annotation):
            yield from _metadata(part)


def _by_key(record: type[BaseModel]) -> dict[str, FieldInfo]:
    return {field.alias or name: field for name, field in record.model_fields.items()}


def _keys(record: type[BaseModel]) -> list[str]:
    return list(_by_key(record))


def _tags(field: FieldInfo | None) -> list[str]:
    """Kinds of tables that a list of them takes."""
    records = [] if field is None else _records(field)
    return [tag for record in records for tag in get_args(record.model_fields["kind"].annotation)]


def _unknown(given: str, known: list[str], what: str = "key") -> str:
    try:
        choose(what, given, known)
    except ValueError as error:
        return str(error)
    return f"{what} {given!r} does not fit here"


def _value(data: Any, place: Place) -> Any:
    for part in place:
        data = data[part]
    return data


def _key(place: Sequence[str | int]) -> str:
    """`place` as one would write it: costs[1].weight."""
    text = ""
    for part in place:
        key = part if isinstance(part, int) or part.isprintable() else repr(part)
        text += f"[{key}]" if isinstance(part, int) else f"{'.' if text else ''}{key}"
    return text


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
