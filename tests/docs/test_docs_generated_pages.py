"""Pages that are generated are complete, and those that are written say what the code does."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import command_reference
import effects_catalogue
import pytest
import rig_reference
import yaml

from sim_core.effects import all_effects
from sim_core.preflight import review
from sim_core.rigs import Rig, load_rig
from sim_core.rigs.motion import compile_experiment, load_experiment
from sysid.recording.message_types import ROLES
from sysid.recording.writer import MARKER_FIELDS, TRACK_FIELDS
from sysid.validation import GROUPS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SCHEMA = Rig.model_json_schema()
MODELS: dict[str, Any] = {"Rig": SCHEMA, **SCHEMA["$defs"]}
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def sections(page: str) -> dict[str, str]:
    """Text below each heading of the second level."""
    return dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", page, re.M | re.S))


def test_the_reference_of_rigs_has_every_model_and_every_key() -> None:
    found = sections(rig_reference.page())
    missing = [name for name in MODELS if name not in found]
    missing += [
        f"{name}.{key}"
        for name, model in MODELS.items()
        for key in model["properties"]
        if f"\n| `{key}` |" not in found.get(name, "")
    ]
    assert missing == []


def test_a_key_of_the_reference_has_its_unit_default_and_bounds() -> None:
    found = sections(rig_reference.page())
    assert "| `dt_s` | number | s | `0.01` | from 1e-06 to 10 | time step |" in found["Solver"]
    assert "| `nu` | number |  | required | above -1 below 0.5 | Poisson's ratio |" in found["GelMaterial"]
    assert "| `axes` | list of `x` or `y` or `z` |  | *none* |" in found["Clamp"]
    assert "[Block](#block) or [Disc](#disc) or [Dome](#dome) or [GelFile](#gelfile)" in found["Gel"]
    assert "Stands at `bodies.NAME`, with `type: gel`." in found["Gel"]


def test_every_link_within_the_reference_has_its_section() -> None:
    page = rig_reference.page()
    assert set(re.findall(r"\(#(\w+)\)", page)) <= {name.lower() for name in sections(page)}


def test_the_catalogue_has_every_effect_with_every_parameter() -> None:
    found = sections(effects_catalogue.page())
    assert list(found) == list(all_effects())
    for name, effect in all_effects().items():
        for parameter in effect.parameters:
            assert f"| `{parameter.name}` | {parameter.unit} |" in found[name]
        assert effect.words in found[name]


@pytest.mark.parametrize("name", all_effects())
def test_the_example_of_an_effect_in_the_catalogue_can_be_read(name: str) -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", sections(effects_catalogue.page())[name], re.S)
    given = yaml.safe_load(text)["effects"][name]
    assert {key: pytest.approx(value) for key, value in all_effects()[name].example.items()} == given


def test_the_command_line_page_has_every_option() -> None:
    found = sections(command_reference.page())
    for name, command in command_reference.commands().items():
        for parameter in command.params:
            if parameter.name != "help":
                shown = parameter.opts[0] if parameter.param_type_name == "option" else parameter.metavar
                assert f"\n| `{shown}" in found[name].replace("\\|", "|"), (name, parameter.name)


def said_commands() -> list[tuple[str, str]]:
    """Command lines of ``thinshell`` in the shell blocks of all pages, with the page."""
    found = []
    for page in PAGES:
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(), re.S):
            for line in block.replace("\\\n", " ").splitlines():
                for part in re.split(r";|&&", line.split(" #")[0]):
                    if part.strip().startswith("thinshell "):
                        found.append((page.relative_to(ROOT).as_posix(), part.strip()))
    return found


@pytest.mark.parametrize(("page", "line"), said_commands())
def test_a_command_in_the_documentation_exists_with_its_options(page: str, line: str) -> None:
    words = shlex.split(line)
    known = command_reference.commands()
    name = next(
        (n for n in (" ".join(words[:3]), " ".join(words[:2]), f"thinshell {words[1]} make") if n in known), None
    )
    assert name is not None, f"{page}: {line}"
    options = {o for p in known[name].params for o in (*p.opts, *p.secondary_opts)} | {"--debug", "--help"}
    given = {word.split("=")[0] for word in words if word.startswith("--") and len(word) > 2}
    assert given <= options, f"{page}: {line}"


def test_the_bag_contract_has_every_default_topic_and_every_type() -> None:
    page = (DOCS / "bag_contract.md").read_text()
    defaults = [MODELS["PoseTopics"]["properties"][key]["default"] for key in ("target_pose", "current_pose")]
    defaults += [MODELS[sensor]["properties"]["topic"]["default"] for sensor in ("WrenchSensor", "MarkerSensor")]
    defaults += [entry["default"] for entry in MODELS["CameraTopics"]["properties"].values()]
    rows = dict(re.findall(r"^\| `([\w/]+)` \| (.*?) \|", page, re.M))
    assert set(defaults) | {"events"} <= set(rows)
    for name, kinds in ROLES.values():
        row = next(rows[topic] for topic in name if topic in rows)
        said = set(re.findall(r"`(.*?)`", row))
        assert kinds[0] in said and said <= set(kinds), name


@pytest.mark.parametrize(("title", "layout"), [("markers", MARKER_FIELDS), ("marker_tracks", TRACK_FIELDS)])
def test_the_bag_contract_has_the_layout_of_clouds(title: str, layout: tuple[tuple[str, int], ...]) -> None:
    page = (DOCS / "bag_contract.md").read_text()
    size, table = re.findall(rf"^`{title}`, (\d+) bytes a point:\n\n(.*?)\n\n", page, re.M | re.S)[0]
    said = []
    for names, offsets, kind in re.findall(r"^\| (`.*?`) \| ([\d, ]+) \| (\w+) \|", table, re.M):
        said += [(n, int(o), kind) for n, o in zip(re.findall(r"`(\w+)`", names), offsets.split(", "), strict=True)]
    kinds = {7: "FLOAT32", 6: "UINT32"}
    assert said == [(name, 4 * k, kinds[kind]) for k, (name, kind) in enumerate(layout)]
    assert int(size) == 4 * len(layout)


def test_the_page_on_validation_has_every_group() -> None:
    named = set(re.findall(r"\[`([\w ]+)`\]\(\.\./sysid/validation", (DOCS / "validation.md").read_text()))
    assert named == set(GROUPS)


def test_the_sensor_of_the_tutorial_has_nothing_wrong() -> None:
    rig = load_rig(ROOT / "examples" / "own_sensor.yaml")
    poses = compile_experiment(load_experiment(ROOT / "examples" / "press_and_twist.yaml"), rig)
    assert review(rig, poses) == []


def test_the_readme_is_short_and_the_citation_complete() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < 150
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["cff-version"] == "1.2.0"
    assert f'version="{citation["version"]}"' in (ROOT / "setup.py").read_text()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_file_that_a_page_links_to_exists(page: Path) -> None:
    generated = {"rig.md", "effects.md", "commands.md", "api/index.md"}
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"```.*?```", "", page.read_text(), flags=re.S)):
        path = link.split("#")[0]
        if not path or "://" in path or path.split("reference/")[-1] in generated:
            continue
        if not (page.parent / path).exists():
            broken.append(link)
    assert broken == []


@pytest.mark.parametrize("page", sorted(p for p in DOCS.rglob("*.md") if "8<" in p.read_text().replace(" ", "")))
def test_pages_hold_the_files_that_they_include(page: Path) -> None:
    # A formatter that takes the mark of a file for code ends what it does, and the page shows the mark.
    markdown = pytest.importorskip("markdown")
    pytest.importorskip("pymdownx")
    places = {"pymdownx.snippets": {"base_path": [str(ROOT / "examples")], "check_paths": True}}
    text = markdown.markdown(page.read_text(), extensions=["pymdownx.snippets"], extension_configs=places)
    assert not re.search(r"8\s*(&lt;|<)", text)
