"""A surface as a binary glTF 2.0 file (Khronos Group, glTF 2.0 Specification, section 4.4), which carries a colour of
each vertex."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from sysid.show.raster import Skin

FLOAT, UNSIGNED_SHORT, UNSIGNED_INT = 5126, 5123, 5125
"""Types of numbers."""

VERTICES, INDICES = 34962, 34963
"""What a part of the block is read as."""

ROUGHNESS = 0.85
"""Of all surfaces: what shines hides colours."""


def binary_gltf(skin: Skin) -> bytes:
    """The file. Colours and opacity are those of the skin, coordinates in m, both sides are drawn."""
    colours = np.ones((len(skin.vertices), 4))
    colours[:, :3] = linear(skin.colours)
    arrays = [
        (np.asarray(skin.vertices, dtype="<f4"), FLOAT, "VEC3", VERTICES),
        (np.asarray((65535.0 * colours).round(), dtype="<u2"), UNSIGNED_SHORT, "VEC4", VERTICES),
        (np.asarray(skin.triangles, dtype="<u4").ravel(), UNSIGNED_INT, "SCALAR", INDICES),
    ]
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    block = b""
    for values, kind, shape, target in arrays:
        accessors.append({"bufferView": len(views), "componentType": kind, "count": len(values), "type": shape})
        views.append({"buffer": 0, "byteOffset": len(block), "byteLength": values.nbytes, "target": target})
        block += values.tobytes()
    place, colour, _ = accessors
    place["min"], place["max"] = (getattr(arrays[0][0], end)(axis=0).tolist() for end in ("min", "max"))
    colour["normalized"] = True
    material = {
        "doubleSided": True,
        "alphaMode": "BLEND" if skin.alpha < 1.0 else "OPAQUE",
        "pbrMetallicRoughness": {
            "baseColorFactor": [1.0, 1.0, 1.0, skin.alpha], "metallicFactor": 0.0, "roughnessFactor": ROUGHNESS,
        },
    }  # fmt: skip
    primitive = {"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0}
    head = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}], "materials": [material], "accessors": accessors,
        "bufferViews": views, "buffers": [{"byteLength": len(block)}],
    }  # fmt: skip
    chunks = _chunk(b"JSON", json.dumps(head, separators=(",", ":")).encode(), b" ") + _chunk(b"BIN\0", block, b"\0")
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks


def linear(colours: np.ndarray) -> np.ndarray:
    """Intensities, which glTF wants, of sRGB values from 0 to 1, ``(n, 3)`` (IEC 61966-2-1)."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def _chunk(kind: bytes, data: bytes, padding: bytes) -> bytes:
    data += padding * (-len(data) % 4)
    return len(data).to_bytes(4, "little") + kind + data
