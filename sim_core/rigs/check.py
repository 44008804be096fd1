"""Checks over several parts of a rig: names that refer to something, regions that hit a body, topics."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from sim_core.errors import nearest_match
from sim_core.rigs.fields import trouble
from sim_core.rigs.pieces import pieces_held

if TYPE_CHECKING:
    from sim_core.rigs.observers import Points
    from sim_core.rigs.regions import Region
    from sim_core.rigs.schema import Rig


def check_references(rig: Rig) -> None:
    """Raise the first inconsistency between the parts of a rig."""
    _check_names(rig)
    _check_mounts(rig)
    _check_clamps(rig)
    _check_held(rig)
    _check_loads(rig)
    _check_joints(rig)
    _check_contacts(rig)
    _check_sensors(rig)
    _check_topics(rig)


def _refer(word: str, known: Iterable[str], kind: str, *path: str | int) -> None:
    known = list(known)
    if word in known:
        return
    remedy = nearest_match(word, known) if known else f"The rig has no {kind} yet; add one."
    raise trouble(f"is {word!r}, but the rig has no such {kind}.", remedy, *path)


def _check_names(rig: Rig) -> None:
    owners: dict[str, str] = {"world": "the base frame", "contacts": "contacts", "effects": "effects", "loads": "loads"}
    named: list[tuple[str, str, tuple[str | int, ...]]] = [
        (name, group, (group, name))
        for group in ("bodies", "end_effectors", "sensors", "cameras")
        for name in getattr(rig, group)
    ]
    for group in ("clamps", "joints", "loads"):
        for index, holder in enumerate(getattr(rig, group)):
            if holder.name is not None:
                named.append((holder.name, group, (group, index, "name")))
    for name, group, path in named:
        if name in owners:
            raise trouble(f"uses a name that is taken by {owners[name]}.", "Choose a name of its own.", *path)
        owners[name] = {"clamps": "a clamp", "joints": "a joint", "loads": "a load"}.get(group, f"one of the {group}")


def _check_mounts(rig: Rig) -> None:
    carriers = ["world", *rig.end_effectors]
    for name, body in rig.bodies.items():
        if (body.type == "gel" or body.type == "rigid") and body.mount is not None:
            _refer(body.mount, carriers, "end effector", "bodies", name, "mount")
    for index, clamp in enumerate(rig.clamps):
        _refer(clamp.mount, carriers, "end effector", "clamps", index, "mount")
    for name, camera in rig.cameras.items():
        _refer(camera.mount, carriers, "end effector", "cameras", name, "mount")


def _check_clamps(rig: Rig) -> None:
    soft = [name for name, body in rig.bodies.items() if body.type in ("sheet", "gel")]
    for index, clamp in enumerate(rig.clamps):
        _refer(clamp.body, soft, "sheet or gel", "clamps", index, "body")
        _check_region(rig, clamp.body, clamp.region, "clamps", index)


def _check_held(rig: Rig) -> None:
    """Without inertia every step is an equilibrium, and what nothing holds has none."""
    if rig.solver.inertia:
        return
    touching = {name for contact in rig.contacts for name in contact.between}
    for name, body in rig.bodies.items():
        if body.type not in ("sheet", "gel") or name in touching or (body.type == "gel" and body.mount is not None):
            continue
        if body.type == "gel" and body.shape.symmetry:
            continue
        free = [piece for piece in pieces_held(rig, name) if not piece.holders]
        if not free:
            continue
        whole = free[0].count == 1
        held = (
            "is held by nothing" if whole else f"is in {free[0].count} pieces, and {free[0].words} is held by nothing"
        )
        join = "Clamp it" if whole else "Join the pieces in the program that made the mesh, clamp each"
        raise trouble(
            f"{held}: no clamp and no contact, and without inertia it has no equilibrium.",
            f"{join}, declare a contact, or set solver.inertia: true.",
            "bodies",
            name,
        )


def _check_loads(rig: Rig) -> None:
    for index, load in enumerate(rig.loads):
        known = [n for n, b in rig.bodies.items() if b.type in ("sheet", "gel")]
        kind = "sheet or gel"
        if load.type != "pressure":
            known += [n for n, b in rig.bodies.items() if b.type == "affine"]
            kind = "sheet, gel or affine body"
        _refer(load.body, known, kind, "loads", index, "body")
        _check_region(rig, load.body, load.region, "loads", index)
        body = rig.bodies[load.body]
        if load.face is None:
            continue
        if body.type != "gel":
            raise trouble(f"is given for a {body.type}.", "Leave it out: only gels have faces.", "loads", index, "face")
        if load.face not in body.shape.faces:
            raise trouble(
                f"is {load.face!r}, which is no face of {load.body!r}.",
                f"Choose one of: {', '.join(body.shape.faces)}." if body.shape.faces else "Name faces by face_regions.",
                "loads",
                index,
                "face",
            )


def _check_region(rig: Rig, name: str, region: Region, *path: str | int) -> None:
    body = rig.bodies[name]
    if body.type == "rigid":
        return
    lower, upper = region.box()
    low, high = body.shape.bounds()
    for axis, key in enumerate(("x_m", "y_m", "z_m")):
        if lower[axis] > high[axis] + 1e-9 or upper[axis] < low[axis] - 1e-9:
            raise trouble(
                f"is [{lower[axis]:g}, {upper[axis]:g}], which misses {name!r}: "
                f"it reaches from {low[axis]:g} to {high[axis]:g}.",
                "The region is in the body's own rest coordinates, in m, with the origin at its centre.",
                *path,
                "region",
                key,
            )


def _check_joints(rig: Rig) -> None:
    affine = [name for name, body in rig.bodies.items() if body.type == "affine"]
    for index, joint in enumerate(rig.joints):
        _refer(joint.body, affine, "affine body", "joints", index, "body")
        _refer(joint.to, ["world", *rig.end_effectors, *affine], "affine body or end effector", "joints", index, "to")
        if joint.to == joint.body:
            raise trouble("connects a body with itself.", "Name another one, or world.", "joints", index, "to")


def _check_contacts(rig: Rig) -> None:
    seen: set[frozenset[str]] = set()
    for index, contact in enumerate(rig.contacts):
        for place, name in enumerate(contact.between):
            _refer(name, rig.bodies, "body", "contacts", index, "between", place)
        first, second = (rig.bodies[name].type for name in contact.between)
        if first == second == "rigid":
            raise trouble(
                f"names two rigid bodies ({contact.name}).",
                "One of the two must be a sheet, a gel or an affine body: rigid bodies follow their mounts.",
                "contacts",
                index,
                "between",
            )
        if contact.between[0] == contact.between[1] and first == "affine":
            raise trouble(
                f"is between {contact.between[0]!r} and itself, which keeps its shape.",
                "Remove it.",
                "contacts",
                index,
                "between",
            )
        if frozenset(contact.between) in seen:
            raise trouble(
                f"lists {contact.name} a second time.", "Keep one entry a pair.", "contacts", index, "between"
            )
        seen.add(frozenset(contact.between))


def _check_sensors(rig: Rig) -> None:
    loaded = [*rig.end_effectors, *(name for name, body in rig.bodies.items() if body.type != "sheet")]
    loaded += [clamp.name for clamp in rig.clamps if clamp.name is not None]
    for name, sensor in rig.sensors.items():
        if sensor.type == "wrench":
            _refer(sensor.on, loaded, "end effector, gel, rigid or affine body, or named clamp", "sensors", name, "on")
            carrier = rig.bodies.get(sensor.on)
            if carrier is not None and carrier.type == "gel" and carrier.mount is None:
                raise trouble(
                    f"is {sensor.on!r}, which is glued to nothing.",
                    "A wrench is measured at a mount: give the gel a mount, or choose another body.",
                    "sensors",
                    name,
                    "on",
                )
        else:
            _check_points(rig, sensor.body, sensor.points, "sensors", name)
    for name, camera in rig.cameras.items():
        taken: set[int] = set()
        for index, sight in enumerate(camera.sees):
            _check_points(rig, sight.body, sight.points, "cameras", name, "sees", index)
            ids = sight.points.ids
            if ids is None and len(camera.sees) > 1 and any(s.points.ids is not None for s in camera.sees):
                raise trouble(
                    "numbers the points of some bodies and not of others.",
                    "Give ids to all points that this camera sees, or to none.",
                    "cameras",
                    name,
                    "sees",
                )
            if ids is not None and taken.intersection(ids):
                raise trouble(
                    f"uses the id {min(taken.intersection(ids))} twice.",
                    "Number every point of a camera once.",
                    "cameras",
                    name,
                    "sees",
                )
            taken.update(ids or ())
        origin = camera.origin_id if camera.model == "scaled_orthographic" else None
        if origin is not None and (origin in taken or not taken):
            raise trouble(
                f"is {origin}, which is also a point of a body."
                if taken
                else f"is {origin}, but the points of the bodies have no ids.",
                "It is a marker of its own: number the points on the bodies otherwise.",
                "cameras",
                name,
                "origin_id",
            )


def _check_points(rig: Rig, body_name: str, points: Points, *path: str | int) -> None:
    moving = [name for name, body in rig.bodies.items() if body.type != "rigid"]
    _refer(body_name, moving, "sheet, gel or affine body", *path, "body")
    body = rig.bodies[body_name]
    if body.type == "rigid":
        return
    if body.type == "affine" and points.grid is not None:
        raise trouble("is given for an affine body.", "Give positions_m, one by one.", *path, "points", "grid")
    if body.shape.type == "mesh" and points.grid is not None:
        raise trouble(
            "is given for a body whose shape is a mesh.", "Give positions_m, one by one.", *path, "points", "grid"
        )
    faces = body.shape.faces if body.type == "gel" else ()
    if points.grid is not None and body.type == "gel" and points.face not in faces:
        given = "is missing." if points.face is None else f"is {points.face!r}, which is no face of this gel."
        raise trouble(given, f"Choose one of: {', '.join(faces)}.", *path, "points", "face")
    if body.type == "sheet" and points.face is not None:
        raise trouble("is given for a sheet.", "A sheet has no faces: leave it out.", *path, "points", "face")
    if points.placed == "first_frame" and (path[0] != "cameras" or body.type != "sheet"):
        raise trouble(
            "is first_frame, which is for points of a sheet that a camera sees.",
            "Leave it out, and give the positions.",
            *path,
            "points",
            "placed",
        )
    if points.positions_m is not None:
        low, high = body.shape.bounds()
        for index, position in enumerate(points.positions_m):
            miss = np.maximum(low - position, np.array(position) - high).max()
            if miss > 1e-6:
                raise trouble(
                    f"lies {miss:.3g} m outside of {body_name!r}.",
                    "Positions are in the body's own rest coordinates, in m, with the origin at its centre.",
                    *path,
                    "points",
                    "positions_m",
                    index,
                )


def _check_topics(rig: Rig) -> None:
    topics: list[tuple[str, tuple[str | int, ...]]] = []
    for name, effector in rig.end_effectors.items():
        for key in ("target_pose", "current_pose"):
            topics.append((getattr(effector.topics, key), ("end_effectors", name, "topics", key)))
    for name, sensor in rig.sensors.items():
        topics.append((sensor.topic, ("sensors", name, "topic")))
    for name, camera in rig.cameras.items():
        for key in ("marker_tracks", "camera_info", "image"):
            topics.append((getattr(camera.topics, key), ("cameras", name, "topics", key)))
    owner: dict[str, tuple[str | int, ...]] = {}
    for topic, path in topics:
        if topic in owner:
            other = ".".join(str(part) for part in owner[topic])
            raise trouble(
                f"is {topic!r}, which is also {other}.",
                f"Give every stream its own topic, for example {path[1]}/{topic.lstrip('/')}.",
                *path,
            )
        owner[topic] = path
