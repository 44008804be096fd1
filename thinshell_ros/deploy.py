"""Let a running ``sim_node`` simulate another rig: that of a fit or of a diagnosis.

    python -m thinshell_ros.deploy fits/fit_1/fitted_rig.yaml --node /thinshell_sim

The rig has to have the same hands, sensors and topics as the one that is simulated. The command ends when the scene of
the rig has been built and is at its start; time, topics and subscribers go on.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from sim_core.errors import ConfigError, WorkerError
from sim_core.rigs import load_rig
from thinshell_ros.command import command
from thinshell_ros.node_client import NodeClient
from thinshell_ros.protocol import BACK

BUILD_S = 600.0
"""Longest time [s] for a scene to be built."""


def deploy(client: NodeClient, node: str, rig: str) -> None:
    """Set the parameter ``rig`` of a ``sim_node``, reset it, and wait until its scene is at its start.

    Raises:
        ConfigError: the rig cannot be read, or the node refuses it.
        WorkerError: the scene is not there after ``BUILD_S``, or the node does not respond.
    """
    load_rig(rig)
    client.set_parameters(node, {"rig": str(Path(rig).absolute()) if Path(rig).is_file() else rig})
    answer, asked = client.trigger(f"{node}/reset"), time.monotonic()
    if not answer.success:
        raise ConfigError(f"{node} does not take {rig}: {answer.message}")
    while answer.message != BACK:
        if time.monotonic() - asked > BUILD_S:
            raise WorkerError(f"{node} has not built its scene after {BUILD_S:g} s: {answer.message}")
        time.sleep(0.2)
        answer = client.trigger(f"{node}/reset")
        if answer.success and answer.message != BACK:
            raise WorkerError(f"{node} does not simulate {rig}: {answer.message}", "See what the node says.")


@command
def main(arguments: Sequence[str]) -> None:
    """Deploy, and say so."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0] if __doc__ else "")
    parser.add_argument("rig", help="rig: a name or a file")
    parser.add_argument("--node", default="/thinshell_sim", help="full name of the node (default: %(default)s)")
    given = parser.parse_args(arguments)
    with NodeClient("deploy_client") as client:
        deploy(client, given.node, given.rig)
    print(f"{given.node} simulates {given.rig}.", flush=True)


if __name__ == "__main__":
    sys.exit(main())
