"""``thinshell tasks``: the tasks that come with the package."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer


def tasks(
    as_json: Annotated[bool, typer.Option("--json", help="Print the list as JSON.")] = False,
) -> None:
    """List the tasks with their variants and what a person calls success.

    Example: thinshell tasks
    """
    from sim_core.tasks import load_task, read_task, task_names
    from sim_core.tasks.actions import ActionSpace

    found: list[dict[str, Any]] = []
    for name in task_names():
        task = read_task(name)
        for variant in task.variants:
            made = load_task(f"{name}:{variant}")
            space = ActionSpace(made)
            found.append(
                {
                    "task": made.name,
                    "title": task.title,
                    "rig": task.rig,
                    "success": made.variant.words,
                    "least_reward": made.variant.success,
                    "conditions": made.conditions.words(),
                    "actions": space.size,
                    "steps": len(space.times) - 1,
                    "duration_s": float(space.times[-1]),
                }
            )
    if as_json:
        print(json.dumps(found, indent=2))
        return
    for row in found:
        asked = "".join(f"; {words}" for words in row["conditions"])
        print(
            f"{row['task']:20s} {row['title']}\n{'':20s} success: {row['success']} "
            f"(reward from {row['least_reward']:g}{asked})\n{'':20s} rig {row['rig']}, {row['actions']} numbers, "
            f"{row['steps']} steps, {row['duration_s']:.3g} s"
        )
