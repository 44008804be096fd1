"""Results that are there whole or not at all."""

import errno
import multiprocessing
import os
import re
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from sim_core.errors import ConfigError, RecordingError
from sim_core.rigs import load_rig
from sysid.io import atomic_folder
from sysid.io.atomic_folder import unfinished, whole_file, whole_folder, write_results
from sysid.workflow import diagnose_bags, fit_bags


def test_a_folder_appears_when_all_is_written(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "fit"
    with whole_folder(out) as folder:
        (folder / "a").write_text("1")
        assert not out.exists()
        assert folder == unfinished(out)
    assert [p.name for p in tmp_path.rglob("*")] == ["deep", "fit", "a"]


@pytest.mark.parametrize("place", ["fit", "deep/deeper/fit", "."])
def test_an_error_leaves_nothing(tmp_path: Path, place: str) -> None:
    with pytest.raises(KeyboardInterrupt), whole_folder(tmp_path / place) as folder:
        (folder / "a").write_text("1")
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("killed", [True, False])
def test_a_folder_that_exists_keeps_what_it_has_and_what_a_killed_process_left_is_gone(
    tmp_path: Path, killed: bool
) -> None:
    out = tmp_path / "fit"
    out.mkdir()
    (out / "mine").write_text("0")
    if killed:
        unfinished(out).mkdir()
        (unfinished(out) / "old").write_text("0")
    with whole_folder(out) as folder:
        (folder / "a").write_text("1")
        assert not (out / "a").exists()
    assert sorted(p.name for p in out.iterdir()) == ["a", "mine"]
    assert [p.name for p in tmp_path.iterdir()] == ["fit"]


WRITES_BYTES = 1 << 22


def _tries_for_long(out: Path) -> None:
    atomic_folder.ROOM_BYTES = 64 * WRITES_BYTES
    with whole_folder(out):
        signal.pause()


def test_a_process_that_is_killed_while_it_looks_for_room_leaves_an_empty_folder(tmp_path: Path) -> None:
    """A node that is killed takes its job along, and the job its folder if that is empty."""
    process = multiprocessing.get_context("fork").Process(target=_tries_for_long, args=(tmp_path / "fit",))
    process.start()
    written = re.compile(r"wchar: (\d+)")
    while int(written.findall(Path(f"/proc/{process.pid}/io").read_text())[0]) < WRITES_BYTES:
        assert process.is_alive()
    process.kill()
    process.join()
    assert [p.name for p in tmp_path.rglob("*")] == [".fit.unfinished"]


def test_a_folder_may_be_a_link_to_another_file_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As seen by rename(2), which refuses to move between what lies below the link and what does not."""
    there, out = tmp_path / "mounted", tmp_path / "fit"
    there.mkdir()
    out.symlink_to(there)
    plain = os.replace

    def rename(old: Any, new: Any) -> None:
        if (there in Path(old).resolve().parents) != (there in Path(new).resolve().parents):
            raise OSError(18, "Invalid cross-device link")
        plain(old, new)

    monkeypatch.setattr(os, "replace", rename)
    with whole_folder(out) as folder:
        (folder / "a").write_text("hours of work")
    assert [p.name for p in there.iterdir()] == ["a"]


def test_what_cannot_be_moved_is_kept_and_reported(tmp_path: Path) -> None:
    out = tmp_path / "fit"
    with pytest.raises(ConfigError, match="finished but cannot be moved") as error, whole_folder(out) as folder:
        (folder / "a").write_text("hours of work")
        out.mkdir()
        (out / "somebody").write_text("else's")
    kept = re.search(r"is in (\S+): move it", str(error.value))
    assert kept and (Path(kept[1]) / "a").read_text() == "hours of work"

    with pytest.raises(ConfigError, match="finished but cannot be moved"), whole_folder(out) as folder:
        (folder / "a").write_text("hours of work")
        (out / "a").mkdir()
    assert (out / ".unfinished" / "a").read_text() == "hours of work"


@pytest.mark.parametrize(
    ("whole", "place"),
    [(whole_folder, "file"), (whole_folder, "link"), (whole_folder, "/proc/fit"), (whole_file, "/proc/page.md")],
)
def test_a_place_that_cannot_be_written_is_refused_before_the_job(tmp_path: Path, place: str, whole: Any) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "nothing")
    with pytest.raises(ConfigError, match=r"cannot be written: .*Name another place"), whole(tmp_path / place):
        pytest.fail("the job has started")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link"]


@pytest.mark.parametrize("job", [lambda **to: fit_bags(names=["card.E_pa"], **to), diagnose_bags])
def test_fits_and_diagnoses_look_for_their_place_before_their_recordings(tmp_path: Path, job: Any) -> None:
    with pytest.raises(ConfigError, match="cannot be written"):
        job(rig=load_rig("card_press"), bags=[tmp_path / "no.bag"], out=Path("/dev/null/fit"))
    with pytest.raises(RecordingError):
        job(rig=load_rig("card_press"), bags=[tmp_path / "no.bag"], out=tmp_path / "deep" / "fit")
    assert not list(tmp_path.iterdir())


def test_a_file_appears_when_all_is_written(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    with whole_file(page) as part:
        part.write_text("half")
        assert not page.exists()
        part.write_text("whole")
    assert page.read_text() == "whole"
    with pytest.raises(KeyboardInterrupt), whole_file(page) as part:
        part.write_text("half")
        raise KeyboardInterrupt
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("page.md", "whole")]


def test_the_working_folder_may_be_named_by_its_dot(tmp_path: Path) -> None:
    script = (
        "from pathlib import Path\n"
        "from sysid.io.atomic_folder import whole_folder\n"
        "with whole_folder(Path('.')) as folder:\n"
        "    (folder / 'a').write_text('1')\n"
    )
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True, timeout=300)
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_results_without_room_are_kept_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(elsewhere))

    def write(folder: Path) -> None:
        if folder.parent != elsewhere:
            raise OSError(errno.ENOSPC, "No space left on device")
        (folder / "fit.json").write_text("{}")

    with pytest.raises(ConfigError, match=r"cannot be written to .*out: No space left on device\. They are kept in"):
        with whole_folder(tmp_path / "out") as folder:
            write_results(folder, tmp_path / "out", [write])
    (kept,) = elsewhere.glob("*/fit.json")
    assert kept.read_text() == "{}" and not (tmp_path / "out").exists()


def test_room_is_tried_before_the_job(tmp_path: Path) -> None:
    """The job is not begun where a file may not become as large as results."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, before[1]))
    try:
        with pytest.raises(ConfigError, match="out cannot be written: File too large"):
            with whole_folder(tmp_path / "out"):
                pytest.fail("the job was begun")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []
