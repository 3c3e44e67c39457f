"""Where the keys of a TOML text stand: `tomllib` reads the values but forgets the lines.

    lines_of(text)[("costs", 1, "weight")]      the line of `weight` in the second [[costs]]

Tables and keys written over several lines or in one line are found; keys within an inline table go by the line of
the table.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

Place = tuple[str | int, ...]
_TABLE = re.compile(r"^\s*(\[\[?)\s*(.+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"""^\s*((?:"[^"]*"|'[^']*'|[\w-]+)(?:\s*\.\s*(?:"[^"]*"|'[^']*'|[\w-]+))*)\s*=""")
_PART = re.compile(r""""([^"]*)"|'([^']*)'|([\w-]+)""")
_TEXTS = re.compile(r"""\"\"\".*?\"\"\"|'''.*?'''|"(?:\\.|[^"\\])*"|'[^']*'|\#.*""")


def lines_of(text: str) -> dict[Place, int]:
    """Line numbers, from 1, of the tables and keys of a TOML text, by their place in what it holds."""
    found: dict[Place, int] = {}
    table: Place = ()
    tables: dict[Place, int] = {}
    depth = 0
    for number, line in enumerate(text.splitlines(), start=1):
        heading = _TABLE.match(line) if depth == 0 else None
        heading = heading if heading and _PART.search(heading[2]) else None
        key = _KEY.match(line) if depth == 0 and not heading else None
        if heading:
            table = _opened(_parts(heading[2]), heading[1] == "[[", tables)
            found.setdefault(table, number)
        elif key:
            place: Place = table
            for part in _parts(key[1]):
                place = (*place, part)
                found.setdefault(place, number)
        if not heading:
            bare = _TEXTS.sub("", line)
            depth = max(0, depth + sum(map(bare.count, "[{")) - sum(map(bare.count, "]}")))
    return found


def line_at(lines: Mapping[Place, int], place: Sequence[str | int]) -> int | None:
    """Line of a place, or of the nearest thing around it; None for what is not in the text."""
    at = tuple(place)
    while at and at not in lines:
        at = at[:-1]
    return lines.get(at)


def _opened(parts: list[str], listed: bool, tables: dict[Place, int]) -> Place:
    """The place of a table that is opened here; tables in lists are counted."""
    place: Place = ()
    for part in parts[:-1]:
        place = (*place, part)
        if place in tables:
            place = (*place, tables[place])
    place = (*place, parts[-1])
    if not listed:
        return place
    tables[place] = tables.get(place, -1) + 1
    return (*place, tables[place])


def _parts(dotted: str) -> list[str]:
    return ["".join(groups) for groups in _PART.findall(dotted)]
