"""Mesh files as Blender, CAD programs, Gmsh and Abaqus write them, put into the dialect that meshio reads.

meshio reads the formats. What it does not know of them is taken out or spelled as it knows it before: normals, texture
coordinates, colours and relative indices of OBJ, a byte-order mark, elements of PLY behind the faces, capitals in STL,
bytes behind the triangles of a binary STL, names of membranes and planar elements in Abaqus input. trimesh knows more
of these, but reads no binary PLY with triangles and quadrilaterals, counts relative indices of OBJ from the end of the
file, and doubles vertices along seams of textures.
"""

from __future__ import annotations

import contextlib
import io
import re
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sim_core.errors import ConfigError

FORMATS = "Triangles: OBJ, STL, PLY, Gmsh (.msh), Abaqus (.inp), VTK. Tetrahedra: Gmsh, Abaqus, VTK (.vtk, .vtu)."

_STL_HEAD, _STL_TRIANGLE = 84, 50
"""Bytes of the head of a binary STL file, the last four of which count the triangles, and of a triangle."""
_STL_LOOK = 1024
"""Bytes by which a binary STL file is known."""
_ABAQUS_SHELLS = re.compile(
    r"(\*element\b.*type\s*=\s*)(M3D|CPE|CPS|SFM3D|STRI|S|R3D|DS|CAX)([34])([A-Z0-9]*)", re.IGNORECASE
)
"""Elements of Abaqus with three or four corners: shells, membranes, surfaces and planar ones."""
_ABAQUS_TETS = re.compile(r"(\*element\b.*type\s*=\s*)(?:C|DC)3D(4|10)([A-Z0-9]*)", re.IGNORECASE)


def read(path: Path) -> Any:
    """The mesh of a file, as meshio has it.

    Raises:
        ConfigError: it cannot be read; the message begins behind the name of the file.
    """
    import meshio

    kind = path.suffix.lower().lstrip(".")
    shown = io.StringIO()
    try:
        # meshio prints what is wrong and ends the process.
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(shown):
            if kind not in _DIALECTS:
                return meshio.read(path)
            with tempfile.TemporaryDirectory(prefix="thinshell-mesh-") as folder:
                spelled = Path(folder) / f"mesh.{kind}"
                spelled.write_bytes(_DIALECTS[kind](path.read_bytes()))
                return meshio.read(spelled)
    except ConfigError:
        raise
    except (Exception, SystemExit) as error:
        reason = " ".join((str(error) if isinstance(error, Exception) else shown.getvalue()).split())
        raise ConfigError(f"cannot be read as a mesh: {reason or type(error).__name__}.", FORMATS) from None


def _text(data: bytes) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16")
    return data.decode("utf-8-sig", errors="replace")


def _obj(data: bytes) -> bytes:
    """Vertices with their three coordinates, and faces with the numbers of these alone, counted from the first."""
    found: list[str] = []
    count = 0
    text = re.sub(r"\\\r?\n", " ", _text(data))
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if words[0] == "v":
            count += 1
            found.append(" ".join(words[:4]))
        elif words[0] == "f":
            corners = [int(word.split("/")[0]) for word in words[1:]]
            if 0 in corners or len(corners) < 3:
                raise ConfigError(
                    f"has the face {' '.join(words[1:])!r} in line {number}.",
                    "Faces have three corners or more, counted from 1: export it again.",
                )
            found.append("f " + " ".join(str(c if c > 0 else count + 1 + c) for c in corners))
    return "\n".join([*found, ""]).encode()


def _ply(data: bytes) -> bytes:
    """The header without elements behind the faces, and the corners of faces under the name that meshio knows."""
    end = re.search(rb"^end_header\s*?\n", data, re.MULTILINE)
    if end is None:
        raise ConfigError("cannot be read as a mesh: its header has no end.", "Export it again.")
    kept: list[bytes] = []
    faces = False
    for line in data[: end.start()].splitlines():
        words = line.split()
        if words[:1] == [b"element"]:
            if faces:
                break
            faces = words[1:2] == [b"face"]
        if faces and words[:2] == [b"property", b"list"] and words[-1] == b"vertex_index":
            line = line.replace(b"vertex_index", b"vertex_indices")
        kept.append(line)
    return b"\n".join([*kept, b"end_header", data[end.end() :]])


def _stl(data: bytes) -> bytes:
    """A binary file up to its last triangle; text, which has no zero bytes, in small letters."""
    if b"\0" not in data[:_STL_LOOK] or data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return _text(data).lower().encode()
    count = struct.unpack_from("<I", data, _STL_HEAD - 4)[0] if len(data) >= _STL_HEAD else 0
    return data[: _STL_HEAD + _STL_TRIANGLE * count]


def _inp(data: bytes) -> bytes:
    """Names of elements that meshio knows, of the same shape."""

    def spelled(match: re.Match[str]) -> str:
        return f"{match[1]}S{match[3]}{'R' if match[3] == '4' else ''}"

    return _ABAQUS_TETS.sub(r"\1C3D\2", _ABAQUS_SHELLS.sub(spelled, _text(data))).encode()


_DIALECTS: dict[str, Callable[[bytes], bytes]] = {"obj": _obj, "ply": _ply, "stl": _stl, "inp": _inp}
