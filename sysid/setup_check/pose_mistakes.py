"""Mistakes in what poses are of, and in the frame that they refer to: another point of the tool, another base, axes,
fingers.

Where a recording begins the hands are mostly where the rig has them. A pose of another point of the tool
(the flange, say) or in another frame (that of the robot's foot) differs from the rig's start by just that constant:

    P_stated = P_true T    (tool),    T = S^-1 P_stated(0)
    P_stated = B P_true    (base),    B = P_stated(0) S^-1

with S the start of the rig. Discrete mistakes need no such guess: exchanged and reversed axes, a pose that is given the
wrong way round, fingers that are exchanged. They are tried where the start that they lead to is nearer to the rig's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.observations.checks.start_poses import reach_of
from sysid.settings.setup_check import SETUP_CHECK
from sysid.setup_check.mistakes import Mistake, Poses, axes_of, commonness, numbers, pose_text, signed_permutations

Frame = tuple[np.ndarray, Rotation]
Posed = tuple[np.ndarray, Rotation]
"""Positions [m] ``(n, 3)`` and rotations."""

Mend = Callable[[Poses], dict[str, PoseTrajectory]]
"""The true poses of the recorded ones."""


def pose_mistakes(rig: Rig, poses: Poses, reach_m: float) -> list[Mistake]:
    """All that are tried of the end effectors, the most common first; ``reach_m``: distance from the rig's start within
    which a recording may begin."""
    found: list[Mistake] = []
    anchored = []
    for name, trajectory in poses.items():
        rest, first = _rest(rig, name), _first(trajectory)
        anchored.append(list(_anchored(name, rest, first)))
        found += anchored[-1]
        found += _exchanged_axes(name, rest, first, reach_m)
        found += _inverted_pose(name, rest, first, reach_m)
    names = list(poses)
    found = [replace(mistake, weight=mistake.weight / len(names)) for mistake in found]  # it may be in any hand
    for k, one in enumerate(names):
        found += [_swapped(rig, one, other) for other in names[k + 1 :]]
    if len(names) > 1:
        found += _of_all(names, anchored)
    return sorted(found, key=lambda mistake: -mistake.weight)


def begins_elsewhere(rig: Rig, poses: Poses) -> bool:
    """Whether any hand begins farther from the rig's start, or turned by more against it, than it moves from there."""
    for name, trajectory in poses.items():
        rest, first = _rest(rig, name), _first(trajectory)
        moves, turns = reach_of(rig, name, trajectory.positions, trajectory.quaternions)
        turn = np.degrees((rest[1].inv() * first[1]).magnitude())
        if turn > turns or np.linalg.norm(first[0] - rest[0]) > moves:
            return True
    return False


def _rest(rig: Rig, name: str) -> Frame:
    start = rig.end_effectors[name].start
    return start.position(), start.rotation()


def _first(trajectory: PoseTrajectory) -> Frame:
    few = min(5, len(trajectory.times))
    return np.median(trajectory.positions[:few], axis=0), Rotation.from_quat(trajectory.quaternions[:few]).mean()


def _anchored(name: str, rest: Frame, first: Frame) -> Iterator[Mistake]:
    """Another point of the tool, and another base."""
    shift = rest[1].inv().apply(first[0] - rest[0])
    turn = rest[1].inv() * first[1]
    turned = np.degrees(turn.magnitude()) > SETUP_CHECK.same_turn_deg
    far = np.linalg.norm(shift) > SETUP_CHECK.same_place_m
    if not turned and not far:
        return
    none, still = np.zeros(3), Rotation.identity()
    # A flange is off the tool along one of its axes, whether or not the hand begins at the rig's start.
    alone = [axis for axis in np.diag(shift) if np.linalg.norm(axis) > SETUP_CHECK.same_place_m]
    offsets = [(axis, 1.0) for axis in alone]
    if len(alone) > 1:  # two offsets are two mistakes at once
        offsets.append((shift, SETUP_CHECK.prior_of_mistake))
    tools: list[tuple[np.ndarray, Rotation, float]] = [(offset, still, common) for offset, common in offsets]
    if turned:
        tools.append((none, turn, 1.0))
        tools += [(offset, turn, common) for offset, common in offsets]
    for offset, rotation, common in tools:
        moved = bool(np.linalg.norm(offset) > 0.0)
        what = f"a point {1e3 * np.linalg.norm(offset):.4g} mm off, at {numbers(offset)} m in its axes" if moved else ""
        angle = np.degrees(rotation.magnitude())
        how = f"axes turned by {angle:.3g} degrees" if angle > SETUP_CHECK.same_turn_deg else ""
        inverse = rotation.inv()
        back = inverse.apply(-offset)
        yield Mistake(
            "tool turned" if not moved else "flange for tool",
            f"the poses of {name} are of another frame of the tool (the flange, say): "
            + " with ".join(filter(None, [what, how])),
            f"end_effectors.{name}.topics.tool: {pose_text(back, inverse)}",
            name, 2.0 * common, poses=_of_one(name, partial(_of_tool, back, inverse)),
        )  # fmt: skip
    base_turn = first[1] * rest[1].inv()
    bases = [(rest[1].apply(offset), still) for offset, _ in offsets]
    bases += [(first[0] - base_turn.apply(rest[0]), base_turn)] if turned else []
    for offset, rotation in bases:
        inverse = rotation.inv()
        back = inverse.apply(-offset)
        angle = np.degrees(rotation.magnitude())
        how = f" and turned by {angle:.3g} degrees" if angle > SETUP_CHECK.same_turn_deg else ""
        yield Mistake(
            "base for base_link", f"the poses of {name} are given in another base, at {numbers(-back)} m{how}",
            f"end_effectors.{name}.topics.base: {pose_text(back, inverse)}", name, 1.0,
            poses=_of_one(name, partial(_of_base, back, inverse)),
        )  # fmt: skip


def _exchanged_axes(name: str, rest: Frame, first: Frame, reach_m: float) -> Iterator[Mistake]:
    """Axes of the base that are exchanged or reversed, of positions alone or of orientations too."""
    here = float(np.linalg.norm(first[0] - rest[0]))
    for matrix in signed_permutations()[1:]:
        begins = matrix.T @ first[0]
        if np.linalg.norm(begins - rest[0]) > reach_m and np.linalg.norm(begins - rest[0]) > 0.5 * here:
            continue
        turned = np.linalg.det(matrix) > 0.0
        word = "turned" if turned else "left-handed"
        proper = Rotation.from_matrix(matrix if turned else -matrix)
        yield Mistake(
            f"base axes {word}", f"the axes of the positions of {name} are {word} ({axes_of(matrix)})",
            f"end_effectors.{name}.topics.axes: {axes_of(matrix)}", name, 0.5 * commonness(matrix),
            poses=_of_one(name, partial(_along, matrix)),
        )  # fmt: skip
        if not turned or np.degrees((proper.inv() * first[1] * rest[1].inv()).magnitude()) < 10.0:
            back = proper.inv()
            yield Mistake(
                f"base axes {word}", f"the axes of the base of {name} are {word} ({axes_of(matrix)})",
                f"end_effectors.{name}.topics.base: {pose_text(np.zeros(3), back)}" if turned
                else f"end_effectors.{name}.topics.axes: {axes_of(matrix)}, and orientations in these axes",
                name, 0.5 * commonness(matrix),
                poses=_of_one(name, partial(_turned, matrix, back, turned)),
            )  # fmt: skip


def _inverted_pose(name: str, rest: Frame, first: Frame, reach_m: float) -> Iterator[Mistake]:
    """The base seen from the tool."""
    back = first[1].inv()
    if np.linalg.norm(-back.apply(first[0]) - rest[0]) > max(reach_m, 0.5 * np.linalg.norm(first[0] - rest[0])):
        return
    yield Mistake(
        "pose inverted", f"the poses of {name} are those of the base, seen from the tool",
        f"publish the poses of {name} in the base frame", name, 0.5,
        poses=_of_one(name, lambda p, r: (-r.inv().apply(p), r.inv())),
    )  # fmt: skip


def _swapped(rig: Rig, one: str, other: str) -> Mistake:
    def exchanged(poses: Poses) -> dict[str, PoseTrajectory]:
        return {**poses, one: poses[other], other: poses[one]}

    topics = (rig.end_effectors[one].topics.current_pose, rig.end_effectors[other].topics.current_pose)
    return Mistake(
        "fingers swapped", f"the poses of {one} and {other} are exchanged",
        f"end_effectors.{one}.topics.current_pose: {topics[1]}, end_effectors.{other}.topics.current_pose: {topics[0]}",
        one, 2.0, poses=exchanged,
    )  # fmt: skip


def _of_all(names: Sequence[str], anchored: Sequence[Sequence[Mistake]]) -> Iterator[Mistake]:
    """One kind of mistake in the poses of all end effectors at once, as of one driver that publishes all of them: the
    last one of each, with which it begins at the rig's start."""
    for kind in dict.fromkeys(mistake.kind for own in anchored for mistake in own):
        whole = [[mistake for mistake in own if mistake.kind == kind] for own in anchored]
        if all(whole):
            each = [own[-1] for own in whole]
            yield Mistake(
                kind, "; ".join(mistake.words for mistake in each), ", ".join(mistake.line for mistake in each),
                names[0], max(mistake.weight for mistake in each),
                poses=partial(_mended_in_turn, [mistake.poses for mistake in each]),
            )  # fmt: skip


def _mended_in_turn(mends: Sequence[Mend | None], poses: Poses) -> dict[str, PoseTrajectory]:
    for mend in mends:
        assert mend is not None
        poses = mend(poses)
    return dict(poses)


def _of_tool(offset: np.ndarray, turn: Rotation, position: np.ndarray, rotation: Rotation) -> Posed:
    return position + rotation.apply(offset), rotation * turn


def _of_base(offset: np.ndarray, turn: Rotation, position: np.ndarray, rotation: Rotation) -> Posed:
    return offset + turn.apply(position), turn * rotation


def _along(matrix: np.ndarray, position: np.ndarray, rotation: Rotation) -> Posed:
    return position @ matrix, rotation


def _turned(matrix: np.ndarray, back: Rotation, proper: bool, position: np.ndarray, rotation: Rotation) -> Posed:
    return position @ matrix, back * rotation if proper else back * rotation * back.inv()


def _of_one(name: str, mend: Callable[[np.ndarray, Rotation], Posed]) -> Mend:
    """The poses of one end effector mended."""

    def mended(poses: Poses) -> dict[str, PoseTrajectory]:
        before = poses[name]
        position, rotation = mend(before.positions, Rotation.from_quat(before.quaternions))
        quaternions = rotation.as_quat()
        signs = np.where(np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0, -1.0, 1.0)
        quaternions = quaternions * np.cumprod(np.concatenate([[1.0], signs]))[:, None]
        return {**poses, name: replace(before, positions=np.asarray(position), quaternions=quaternions)}

    return mended
