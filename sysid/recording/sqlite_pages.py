"""Rows of a damaged sqlite3 file, read from its leaf pages themselves.

A query ends at the first damaged page on its way, and none begins where the first page is. The rows of a table lie in
leaf pages, each of which can be read without any other (The SQLite Database File Format, sqlite.org/fileformat.html,
sections 1.6 and 2.1); content that is too long for a page goes on in pages that are chained from it.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

Value = int | str | bytes | float | None

_HEADER = 100
_LEAF = 0x0D
_INTS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
"""Bytes of the integers of a serial type."""

PAGE = 4096
"""Bytes of a page where the header does not tell."""


@dataclass(frozen=True)
class Row:
    """A row of any table: its number, the place of its cell in the file, and its values; the bytes of a blob are left
    out unless they are asked for."""

    number: int
    at: int
    values: tuple[Value, ...]


class Pages:
    """A file of sqlite by pages."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._data = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        stated = int.from_bytes(self._data[16:18], "big")
        stated = 65536 if stated == 1 else stated
        self._page = stated if stated in {1 << k for k in range(9, 17)} else PAGE
        reserved = self._data[20] if len(self._data) > 20 else 0
        self._usable = self._page - (reserved if reserved < 64 else 0)

    def close(self) -> None:
        """Close the file."""
        self._data.close()
        self._file.close()

    def rows(self) -> Iterator[Row]:
        """All rows of leaf pages that can be read, page by page."""
        for begin in range(0, len(self._data) - 7, self._page):
            head = begin + (_HEADER if begin == 0 else 0)
            if head + 8 > len(self._data) or self._data[head] != _LEAF:
                continue
            count = int.from_bytes(self._data[head + 3 : head + 5], "big")
            for k in range(min(count, self._page // 4)):
                pointer = head + 8 + 2 * k
                offset = int.from_bytes(self._data[pointer : pointer + 2], "big")
                if not head - begin + 8 + 2 * count <= offset < self._usable:
                    continue
                try:
                    yield self.row(begin + offset)
                except (ValueError, IndexError, UnicodeDecodeError):
                    continue  # a damaged cell

    def row(self, at: int, blobs: bool = False) -> Row:
        """The row whose cell is at a place. Raises ``ValueError`` or ``IndexError`` where it is damaged."""
        size, here = self._varint(at)
        number, here = self._varint(here)
        most = self._usable - 35
        local = size
        if size > most:
            least = (self._usable - 12) * 32 // 255 - 23
            local = least + (size - least) % (self._usable - 4)
            local = local if local <= most else least
        if here + local > (at // self._page + 1) * self._page or size > len(self._data):
            raise ValueError("the cell ends beyond its page")
        payload = self._data[here : here + local]
        if blobs and local < size:
            payload += self._chained(here + local, size - local)
        return Row(number, at, tuple(_values(payload, size, blobs)))

    def _chained(self, pointer: int, wanted: int) -> bytes:
        found = bytearray()
        following = int.from_bytes(self._data[pointer : pointer + 4], "big")
        while len(found) < wanted:
            begin = (following - 1) * self._page
            if following < 2 or begin + 4 > len(self._data):
                raise ValueError("the chain of its pages is broken")
            following = int.from_bytes(self._data[begin : begin + 4], "big")
            found += self._data[begin + 4 : begin + self._usable]
        return bytes(found[:wanted])

    def _varint(self, at: int) -> tuple[int, int]:
        return _varint(self._data, at)


def _varint(data: bytes | mmap.mmap, at: int) -> tuple[int, int]:
    """A number of one to nine bytes, and the place behind it."""
    value = 0
    for k in range(9):
        byte = data[at + k]
        if k == 8:
            return value << 8 | byte, at + 9
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + k + 1
    raise ValueError("no number")


def _values(payload: bytes, size: int, blobs: bool) -> Iterator[Value]:
    """The columns of a record of ``size`` bytes, of which at least the first ones are in the payload."""
    head, here = _varint(payload, 0)
    kinds = []
    while here < head:
        kind, here = _varint(payload, here)
        kinds.append(kind)
    if here != head or not kinds:
        raise ValueError("the header of the record has another length")
    lengths = [_length(kind) for kind in kinds]
    if head + sum(lengths) != size:
        raise ValueError("the columns do not fill the record")
    for kind, length in zip(kinds, lengths, strict=True):
        raw = payload[here : here + length]
        here += length
        if kind >= 12 and kind % 2 == 0:
            if blobs and len(raw) < length:
                raise ValueError("the content is not all there")
            yield raw if blobs else b""
        elif kind >= 13:
            yield raw.decode()
        elif kind in _INTS:
            yield int.from_bytes(raw, "big", signed=True)
        else:
            yield {8: 0, 9: 1}.get(kind)


def _length(kind: int) -> int:
    """Bytes of a column by its serial type."""
    if kind in (10, 11):
        raise ValueError("a serial type that is reserved")
    return (kind - 12) // 2 if kind >= 12 else _INTS.get(kind, 8 if kind == 7 else 0)
