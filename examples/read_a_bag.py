"""What a recording holds, as arrays in SI units. No ROS is needed."""

from pathlib import Path

import numpy as np

from sysid import read_recording

BAG = Path(__file__).parents[1] / "bags" / "press_post"


def main() -> float:
    """Returns the largest force [N]."""
    recording = read_recording(BAG)
    for topic, count in recording.provenance.message_counts.items():
        print(f"{topic}: {count} messages")
    for note in recording.notes:
        print(note)
    (pose,), (wrench,) = recording.poses.values(), recording.wrenches.values()
    height = np.ptp(pose.position[:, 2])
    force = float(np.linalg.norm(wrench.force, axis=1).max())
    print(f"The finger moves by {1e3 * height:.1f} mm in height and feels {force:.2f} N in {wrench.frame_id}.")
    assert pose.quaternion.shape == (len(pose.t), 4)
    assert force > 0.1
    return force


if __name__ == "__main__":
    main()
