"""On which channels the pose of an end effector may act: through what it carries, and what that touches."""

from __future__ import annotations

from collections.abc import Collection

from sim_core.rigs import WORLD, Affine, Gel, Rig, Rigid, Sheet, WrenchSensor


def influencing_end_effectors(rig: Rig, channels: Collection[str]) -> list[str]:
    """End effectors whose pose may act on what is measured, in the order of the rig."""
    seen = {thing for channel in channels for thing in _seen(rig, channel)}
    return [name for name in rig.end_effectors if seen & _reached(rig, name)]


def _seen(rig: Rig, channel: str) -> set[str]:
    """Bodies and mounts that a channel depends on."""
    if channel in rig.cameras:
        camera = rig.cameras[channel]
        return {camera.mount, *(sight.body for sight in camera.sees)}
    sensor = rig.sensors[channel]
    if not isinstance(sensor, WrenchSensor):
        return {sensor.body}
    clamp = next((c for c in rig.clamps if c.name == sensor.on), None)
    return {sensor.on} if clamp is None else {clamp.mount, clamp.body}


def _reached(rig: Rig, effector: str) -> set[str]:
    """The end effector, and all bodies and mounts that feel where it is. What is moved by another mount feels it, and
    passes nothing on."""
    pairs = [(c.mount, c.body) for c in rig.clamps] + [(j.to, j.body) for j in rig.joints]
    pairs += [contact.between for contact in rig.contacts]
    pairs += [(m, name) for name, body in rig.bodies.items() if (m := _mount(body)) is not None]
    driven = {*rig.end_effectors, *(n for n, b in rig.bodies.items() if isinstance(b, Rigid))}
    reached, ahead = {effector}, [effector]
    while ahead:
        here = ahead.pop()
        if here in driven and here != effector and not _carries(rig, effector, here):
            continue
        for pair in pairs:
            if here in pair:
                fresh = set(pair) - reached - {WORLD}
                reached |= fresh
                ahead += fresh
    return reached


def _carries(rig: Rig, effector: str, name: str) -> bool:
    """Whether a body is fixed to an end effector."""
    return name in rig.bodies and _mount(rig.bodies[name]) == effector


def _mount(body: Sheet | Gel | Rigid | Affine) -> str | None:
    """Mount in whose frame a body is fixed."""
    return body.mount if isinstance(body, Gel | Rigid) else None
