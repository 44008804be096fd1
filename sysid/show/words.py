"""Bodies, contacts, sensors and cameras of a rig in a few words each."""

from __future__ import annotations

from sim_core.rigs import Affine, Gel, OrthographicCamera, Rig, Rigid, Sheet, WrenchSensor

PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""))


def with_prefix(value: float, unit: str) -> str:
    """A positive value with an SI prefix: ``200 kPa``."""
    factor, prefix = next((p for p in PREFIXES if value >= p[0]), PREFIXES[-1])
    return f"{value / factor:.3g} {prefix}{unit}"


def _millimetres(*lengths: float) -> str:
    return " x ".join(f"{1e3 * length:.3g}" for length in lengths) + " mm"


def body_words(rig: Rig, name: str) -> str:
    """Shape, size, material and what holds a body."""
    spec = rig.bodies[name]
    shape = spec.shape
    if shape.type == "rectangle":
        size = _millimetres(shape.length_m, shape.width_m)
    elif shape.type in ("block", "box"):
        size = _millimetres(*shape.size_m)
    elif shape.type == "cylinder":
        size = f"radius {_millimetres(shape.radius_m)}, length {_millimetres(shape.length_m)}"
    elif shape.type in ("dome", "sphere"):
        size = f"radius {_millimetres(shape.radius_m)}"
    else:
        size = ""
    parts = [" ".join(filter(None, [shape.type, size]))]
    if isinstance(spec, Sheet):
        m = spec.material
        parts += [f"{1e3 * m.thickness_m:.3g} mm thick", f"E {with_prefix(m.E_pa, 'Pa')}", f"\u03bd {m.nu:g}"]
    elif isinstance(spec, Gel):
        parts += [f"E {with_prefix(spec.material.E_pa, 'Pa')}", f"\u03bd {spec.material.nu:g}"]
        parts += [f"'{spec.bonded}' glued to {spec.mount}"] if spec.bonded else ["free"]
    elif isinstance(spec, Affine):
        parts += [f"{spec.material.density_kg_m3:g} kg/m\u00b3", "free"]
    elif isinstance(spec, Rigid) and spec.mount != "world":
        parts.append(f"on {spec.mount}")
    kind = {"sheet": "sheet", "gel": "gel", "rigid": "rigid", "affine": "stiff body"}[spec.type]
    return f"{kind}: {', '.join(parts)}"


def contact_words(rig: Rig) -> list[str]:
    """Each declared contact with its friction."""
    return [f"{c.between[0]} \u2013 {c.between[1]}, \u03bc {c.friction:g}" for c in rig.contacts]


def sensor_words(rig: Rig) -> list[str]:
    """Each sensor and camera with what it looks at."""
    found = []
    for name, sensor in rig.sensors.items():
        if isinstance(sensor, WrenchSensor):
            found.append(f"{name}: wrench on {sensor.on}, {sensor.rate_hz:g} Hz")
        else:
            found.append(f"{name}: {sensor.points.count} markers of {sensor.body}, {sensor.rate_hz:g} Hz")
    for name, camera in rig.cameras.items():
        seen = ", ".join(f"{s.points.count} points of {s.body}" for s in camera.sees)
        kind = "orthographic" if isinstance(camera, OrthographicCamera) else camera.model
        found.append(f"{name}: {kind} camera {camera.width_px} x {camera.height_px} px on {camera.mount}, sees {seen}")
    return found
