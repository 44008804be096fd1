"""Which topics of a rig a recording is said to lack."""

from __future__ import annotations

import pytest

from sim_core.rigs import Rig, load_rig, parse_rig
from sysid.observations.rig_topics import topics_of
from sysid.recording.topics import sensor_topic


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("card_press")


def topics(rig: Rig) -> set[str]:
    """What a recording of the rig has, without images."""
    hands = {e.topics.current_pose for e in rig.end_effectors.values()}
    return hands | {s.topic for s in rig.sensors.values()} | {c.topics.marker_tracks for c in rig.cameras.values()}


def test_neither_images_next_to_tracks_nor_intrinsics_nor_commanded_poses_are_missed(rig: Rig) -> None:
    assert topics_of(rig, topics(rig))[1] == ()


def test_a_sensor_tracks_and_measured_poses_are_missed(rig: Rig) -> None:
    (camera,), (hand,) = rig.cameras.values(), rig.end_effectors.values()
    sensor = next(iter(rig.sensors.values()))
    there = topics(rig) - {sensor.topic, camera.topics.marker_tracks, hand.topics.current_pose}
    names, missing = topics_of(rig, there | {hand.topics.target_pose})
    assert set(missing) == {sensor.topic, camera.topics.marker_tracks, hand.topics.current_pose}
    (pose,) = names.ee.values()
    assert (pose.current_pose, pose.target_pose) == (None, hand.topics.target_pose)


def test_what_a_rig_says_of_units_and_orders_is_taken(rig: Rig) -> None:
    """Also that a pose (1, 0, 0, 0), of a tool that points down, is not an identity with w first."""
    data = rig.model_dump(exclude_none=True)
    hand, sensors = next(iter(data["end_effectors"])), list(data["sensors"])
    data["end_effectors"][hand]["topics"] |= {"length_unit": "m", "quaternion_order": "xyzw"}
    for name in sensors:
        data["sensors"][name]["length_unit"] = "mm"
    stated = parse_rig(data, "stated")
    names, _ = topics_of(stated, topics(stated))
    assert (names.ee[hand].length_unit, names.ee[hand].quaternion_order) == ("m", "xyzw")
    read = {**names.wrench, **names.markers}
    assert [sensor_topic(read[name]).length_unit for name in sensors] == ["mm"] * len(sensors)
    unstated, _ = topics_of(rig, topics(rig))
    assert (unstated.ee[hand].length_unit, unstated.ee[hand].quaternion_order) == (None, None)
