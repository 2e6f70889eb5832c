"""What is written takes the place of what was there only once it is whole."""

import errno
import json
import os
import stat
import subprocess
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import spatial_pin as sp

posix = pytest.mark.skipif(os.name != "posix", reason="limits and signals of POSIX")
OLD = "what was there before"


@pytest.fixture(scope="module")
def motion() -> sp.Motion:
    return sp.sweep(sp.load("four_bar"), "crank", np.linspace(0.0, 1.0, 400), speed=1.0)


WRITERS = {
    "a.csv": lambda motion, path: motion.to_csv(path),
    "a.npz": lambda motion, path: motion.save(path),
    "a.svg": lambda motion, path: sp.plot(motion, "rocker_pin", path),
    "a.html": lambda motion, path: sp.export_html(motion, path),
    "report.html": lambda motion, path: sp.report(motion, path),
}
COMMANDS = {
    "b.urdf": lambda path: ("export", "four_bar", "--urdf", path),
    "b.json": lambda path: ("sweep", "four_bar", "crank", 0, 1, "--steps", 99, "--json", path),
}


@contextmanager
def full_disk(limit: int = 512):
    """Let no file grow beyond `limit` bytes."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@posix
@pytest.mark.parametrize("name", [*WRITERS, *COMMANDS])
def test_a_disk_that_gets_full_loses_nothing(motion, tmp_path, name, run):
    path = tmp_path / name
    path.write_text(OLD)
    if name in COMMANDS:
        with full_disk():
            code, _, err = run(*COMMANDS[name](path))
        assert code == 1 and name in err
    else:
        with pytest.raises((OSError, sp.SpatialPinError), match=name), full_disk():
            WRITERS[name](motion, path)
    assert path.read_text() == OLD
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", [*WRITERS, *COMMANDS])
def test_a_new_file_takes_the_place_of_the_old_one(motion, tmp_path, name, run):
    path = tmp_path / name
    path.write_text(OLD)
    if name in COMMANDS:
        assert run(*COMMANDS[name](path))[0] == 0
    else:
        WRITERS[name](motion, path)
    assert path.stat().st_size > len(OLD)
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


@posix
def test_permissions_are_those_of_the_old_file_or_the_usual_ones(motion, tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_text(OLD)
    old.chmod(0o640)
    before = os.umask(0o027)
    try:
        for path in (old, new):
            motion.to_csv(path)
    finally:
        os.umask(before)
    assert [stat.S_IMODE(p.stat().st_mode) for p in (old, new)] == [0o640, 0o640]


@posix
def test_a_link_stays_a_link_and_its_file_is_written(motion, tmp_path):
    real, link = tmp_path / "real", tmp_path / "link"
    real.write_text(OLD)
    link.symlink_to(real)
    motion.to_csv(link)
    assert link.is_symlink()
    assert real.read_text() == motion.to_csv()


@posix
def test_a_pipe_is_written_to(motion, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    copied = tmp_path / "copied.npz"
    with copied.open("wb") as file:
        reader = subprocess.Popen(["cat", str(pipe)], stdout=file)
        assert motion.save(pipe) == pipe
        assert reader.wait(60) == 0
    assert np.array_equal(sp.Motion.load(copied, motion.mechanism).q, motion.q)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is full")
@pytest.mark.parametrize("option", ["--npz", "--csv", "--json", "--html"])
def test_a_device_that_is_full_gets_a_clear_error(option, run):
    code, _, err = run("sweep", "four_bar", "crank", 0, 1, "--steps", 5, option, "/dev/full")
    assert code == 1 and f"/dev/full: {os.strerror(errno.ENOSPC)}" in err
    assert not Path("/dev/full.npz").exists()


def test_what_stands_in_a_command_is_written_to_the_screen(run):
    if not Path("/dev/stdout").exists():
        pytest.skip("there is no /dev/stdout")
    code, out, _ = run("info", "four_bar", "--json", "/dev/stdout")
    assert code == 0 and json.loads(out)


@pytest.mark.parametrize("path", [None, 3, b"a.csv", "", "a\0b", "."])
def test_what_is_no_name_of_a_file_is_refused(motion, path):
    if path is not None:
        with pytest.raises((TypeError, ValueError), match="name of a file"):
            motion.to_csv(path)  # which returns the text where there is no path
    for write in (motion.save, motion.to_npz, lambda p: sp.report(motion, p),
                  lambda p: sp.export_html(motion, p), lambda p: sp.movie(motion, p)):
        with pytest.raises((TypeError, ValueError), match=r"name or a path|name of a file|\.gif"):
            write(path)


def test_names_with_a_dollar_are_drawn_as_they_are(tmp_path):
    saved = sp.load("four_bar").save(tmp_path / "saved")
    for path in saved.parent.iterdir():
        text = path.read_text().replace("\nrocker_pin", '\n"rocker_pin"')
        path.write_text(text.replace("rocker_pin", "$rocker^$"))
    motion = sp.sweep(sp.load(saved), "crank", np.linspace(0.0, 1.0, 9), speed=1.0)
    page = sp.report(motion, tmp_path / "page.html", outputs="$rocker^$.rate").read_text()
    assert "$rocker^$" in page
    figure = sp.plot(motion, "$rocker^$", tmp_path / "a.svg", title="$x^$")
    assert figure.axes[0].get_title("left").startswith(r"\$rocker^\$")


@pytest.mark.parametrize("name", ["a.csv", "a.npz", "a.svg", "a.html"])
def test_a_folder_that_does_not_exist_is_reported_with_the_file(motion, tmp_path, name):
    path = tmp_path / "none" / name
    with pytest.raises(FileNotFoundError) as error:
        WRITERS[name](motion, path)
    assert str(error.value) == f"[Errno 2] No such file or directory: {str(path)!r}"
