"""The lines of the keys of a TOML text: tomllib gives values without their lines.

tomllib must have read the text without an error; nothing is checked here.
"""

from __future__ import annotations

import re
from typing import Any

Path = tuple[Any, ...]  # ("fluids", 0, "box", "lo")

_BLANK = re.compile(r"(?:\s|#[^\n]*)*")
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SCALAR = re.compile(r"[^,\]}#\n]+")
_STRINGS = re.compile(r'"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'', re.S)


def key_lines(text: str) -> dict[Path, int]:
    """The line, counted from 1, of every table, key and element of a list."""
    return _Scanner(text).scan()


class _Scanner:
    def __init__(self, text: str):
        self.text, self.at = text, 0
        self.lines: dict[Path, int] = {}
        self.lengths: dict[Path, int] = {}  # of the arrays of tables

    def scan(self) -> dict[Path, int]:
        table: Path = ()
        while self._skip_blank():
            if self.text[self.at] == "[":
                table = self._header()
            else:
                self._key_value(table)
        return self.lines

    def _note(self, path: Path) -> None:
        self.lines.setdefault(path, self.text.count("\n", 0, self.at) + 1)

    def _skip_blank(self) -> bool:
        """Past white space and comments; whether anything is left."""
        self._match(_BLANK)
        return self.at < len(self.text)

    def _match(self, pattern: re.Pattern[str]) -> str:
        """What a pattern matches here, which is passed."""
        found = pattern.match(self.text, self.at)
        assert found  # the text is TOML
        self.at = found.end()
        return found[0]

    def _skip(self, characters: str) -> None:
        while self.text[self.at] in characters:
            self.at += 1

    def _header(self) -> Path:
        n_brackets = 2 if self.text.startswith("[[", self.at) else 1
        start = self.at
        self.at += n_brackets
        path = self._resolve(self._keys("]"))
        self.at += n_brackets
        end, self.at = self.at, start
        if n_brackets == 2:
            self._note(path)
            index = self.lengths.get(path, 0)
            self.lengths[path] = index + 1
            path = (*path, index)
        self._note(path)
        self.at = end
        return path

    def _resolve(self, keys: Path) -> Path:
        """The path that a header names: in an array of tables, its last table is meant."""
        path: Path = ()
        for i, key in enumerate(keys):
            path = (*path, key)
            if path in self.lengths and i + 1 < len(keys):
                path = (*path, self.lengths[path] - 1)
        return path

    def _keys(self, end: str) -> Path:
        """The parts of a dotted key, up to the character `end`."""
        keys: list[str] = []
        while True:
            self._skip(" \t.")
            if self.text[self.at] == end:
                return tuple(keys)
            quoted = self.text[self.at] in "\"'"
            word = self._match(_STRINGS if quoted else _BARE)
            keys.append(word[1:-1] if quoted else word)

    def _key_value(self, table: Path) -> None:
        start = self.at
        keys = self._keys("=")
        end, self.at = self.at + 1, start
        for i in range(len(keys)):
            self._note((*table, *keys[: i + 1]))
        self.at = end
        self._value((*table, *keys))

    def _value(self, path: Path) -> None:
        self._skip_blank()
        opening = self.text[self.at]
        if opening not in "[{":
            self._match(_STRINGS if opening in "\"'" else _SCALAR)
            return
        self.at += 1
        index = 0
        while True:
            self._skip_blank()
            if self.text[self.at] in "]}":
                self.at += 1
                return
            if self.text[self.at] == ",":
                self.at += 1
            elif opening == "[":
                self._note((*path, index))
                self._value((*path, index))
                index += 1
            else:
                self._key_value(path)
