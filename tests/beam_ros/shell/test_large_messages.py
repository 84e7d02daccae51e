"""Room in shared memory for frames of megabytes, and what killed senders leave in it."""

from __future__ import annotations

import fcntl
import os
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from beam_ros.interfaces.graph import QualityOfService
from beam_ros.process.environment import child_environment
from beam_ros.shell.large_messages import (
    PROFILE,
    PROFILE_VARIABLE,
    SHARED_MEMORY,
    remove_orphans,
    segment_bytes,
    widen_shared_memory,
)

LONG_AGO_S = 3600.0
FRAMES = 10
"""Of 2 MB: together they fit into the packaged profile's shared memory, and by far not into the usual one."""


def make_segment(folder: Path, number: int, size: int, *, age_s: float = LONG_AGO_S) -> Path:
    """Make the two files of a sender, as Fast DDS does; return the lock's."""
    segment = folder / f"fastrtps_{number:016x}"
    with segment.open("wb") as stream:
        stream.truncate(size)
    lock = folder / f"{segment.name}_el"
    lock.touch()
    grow_old(lock, age_s)
    return lock


def grow_old(lock: Path, age_s: float = LONG_AGO_S) -> None:
    """Date a lock's file back."""
    os.utime(lock, (time.time() - age_s,) * 2)


def large_segments_of(pid: int) -> list[Path]:
    """Find the large shared memory that a process has mapped."""
    words = {line.split()[-1] for line in Path(f"/proc/{pid}/maps").read_text().splitlines()}
    mapped = [Path(word) for word in words if word.startswith(f"{SHARED_MEMORY}/fastrtps_")]
    return [path for path in mapped if path.exists() and path.stat().st_size >= segment_bytes()]


@pytest.fixture
def start_camera() -> Iterator[Callable[[str], subprocess.Popen[bytes]]]:
    pytest.importorskip("rclpy")
    cameras = []

    def start(topic: str) -> subprocess.Popen[bytes]:
        camera = subprocess.Popen(
            [sys.executable, "-m", "tests.beam_ros.nodes.large_frames_camera", topic, str(FRAMES)],
            cwd=Path(__file__).parents[3],
            env=child_environment(),
            start_new_session=True,
        )
        cameras.append(camera)
        return camera

    yield start
    for camera in cameras:
        segments = large_segments_of(camera.pid) if camera.poll() is None else []
        camera.kill()
        camera.wait()
        for segment in segments:
            grow_old(segment.with_name(f"{segment.name}_el"))
    remove_orphans(segment_bytes())


@pytest.mark.ros
def test_frames_sent_at_once_all_arrive_though_nobody_repeats_them(graph, start_camera) -> None:
    from beam_ros.shell.node import qos_profile

    seen: list[int] = []
    graph.node.create_subscription(
        graph.types.message_class("sensor_msgs/msg/Image"),
        "/large/camera/image_raw",
        lambda data: seen.append(struct.unpack_from("<I", data, 8)[0]),
        qos_profile(QualityOfService(FRAMES, is_reliable=False)),
        raw=True,
    )
    start_camera("/large/camera/image_raw")
    graph.wait(lambda: len(seen) >= 1, "a frame", 20.0)
    graph.spin(0.5)
    assert seen == list(range(1, FRAMES + 1))


@pytest.mark.ros
def test_what_a_killed_sender_leaves_is_taken_away_and_what_a_living_one_uses_is_not(
    graph, start_camera
) -> None:
    camera = start_camera("/nobody/listens")
    graph.wait(lambda: bool(large_segments_of(camera.pid)), "a large segment", 20.0)
    (segment,) = large_segments_of(camera.pid)
    lock = segment.with_name(f"{segment.name}_el")
    grow_old(lock)
    assert segment.name not in remove_orphans(segment_bytes())
    camera.kill()
    camera.wait()
    assert segment.exists()
    assert segment.name in remove_orphans(segment_bytes())
    assert not segment.exists()
    assert not lock.exists()


@pytest.mark.ros
def test_nodes_that_send_frames_share_much_memory(executables, graph, tmp_path: Path) -> None:
    port = ("-p", f"emulator.port_link:={tmp_path / 'controller'}")
    nodes = [
        executables.start(name, "--ros-args", "-r", f"__ns:=/{name}", *port)
        for name in ("simulator", "vision_tracker", "firmware_emulator")
    ]
    for node in nodes:
        graph.wait(
            lambda node=node: bool(large_segments_of(node.process.pid)), f"large memory of {node.name}", 20.0
        )


def test_the_page_tells_how_a_camera_driver_gets_the_profile() -> None:
    root = Path(__file__).parents[3]
    page = (root / "docs" / "tracker-node.md").read_text(encoding="utf-8")
    assert f"export {PROFILE_VARIABLE}=$PWD/{PROFILE.relative_to(root)} " in page


def test_a_choice_of_the_user_stays(tmp_path: Path) -> None:
    for name in (PROFILE_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS"):
        environ = {name: "mine"}
        widen_shared_memory(environ, tmp_path)
        assert environ == {name: "mine"}


def test_where_the_machine_has_little_shared_memory_nothing_changes(tmp_path: Path) -> None:
    environ: dict[str, str] = {}
    widen_shared_memory(environ, tmp_path / "absent")
    assert environ == {}


def test_the_profile_is_chosen_where_nobody_chose_another(tmp_path: Path) -> None:
    environ = {PROFILE_VARIABLE: ""}
    widen_shared_memory(environ, tmp_path)
    assert environ == {PROFILE_VARIABLE: str(PROFILE)}


def test_only_old_large_segments_without_an_owner_are_taken_away(tmp_path: Path) -> None:
    size = segment_bytes()
    orphan = make_segment(tmp_path, 1, size)
    kept = [
        make_segment(tmp_path, 2, size - 1),
        make_segment(tmp_path, 3, size, age_s=0.0),
        make_segment(tmp_path, 4, size),
    ]
    (tmp_path / "fastrtps_port7000_el").touch()
    (tmp_path / f"fastrtps_{5:016x}_el").touch()
    before = len(list(tmp_path.iterdir()))
    with kept[-1].open("rb") as owner:
        fcntl.flock(owner, fcntl.LOCK_EX)
        assert remove_orphans(size, tmp_path) == [orphan.name.removesuffix("_el")]
    assert all(lock.exists() for lock in kept)
    assert len(list(tmp_path.iterdir())) == before - 2
