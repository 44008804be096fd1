"""What a colcon build needs: version, packages, executables, and files under share/.

The rest is in pyproject.toml. These parts are here because ``colcon build --symlink-install`` runs this
file without pyproject.toml beside it, and because colcon cannot read a package whose pyproject.toml
gives ``requires-python``.
"""

from pathlib import Path

from setuptools import find_packages, setup

ROOT = Path(__file__).resolve().parent
SHARE = Path("share/thinshell_ros")


def share_files() -> list[tuple[str, list[str]]]:
    """Target folder and files of package.xml, config/ and launch/."""
    folders: dict[Path, list[str]] = {SHARE: ["package.xml"]}
    for top in ("config", "launch"):
        for path in sorted((ROOT / top).rglob("*")):
            if path.is_file():
                relative = path.relative_to(ROOT)
                folders.setdefault(SHARE / relative.parent, []).append(relative.as_posix())
    return [(folder.as_posix(), files) for folder, files in folders.items()]


setup(
    name="thinshell_ros",
    version="0.1.0",
    python_requires=">=3.10,<3.14",
    packages=find_packages(str(ROOT), include=["sim_core*", "sysid*", "thinshell_ros*"]),
    data_files=[("share/ament_index/resource_index/packages", ["resource/thinshell_ros"]), *share_files()],
    entry_points={
        "console_scripts": [
            "thinshell = sysid.cli.app:main",
            "sim_node = thinshell_ros.sim_node:main",
            "record_node = thinshell_ros.record_node:main",
            "sysid_node = thinshell_ros.sysid_node:main",
            "replay_node = thinshell_ros.replay_node:main",
        ],
    },
)
