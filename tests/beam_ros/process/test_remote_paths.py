"""Bags elsewhere: read by index and ranges from an object store, with the same answers as from the disk."""

from __future__ import annotations

import importlib.util
import os
import re
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from beam_ros.bags.errors import BagNotFoundError, BagTruncatedError
from beam_ros.bags.reading import Bag
from beam_ros.bags.summary import summarise
from beam_ros.cli.main import main
from beam_ros.errors import UsageError
from beam_ros.process.remote_paths import RemotePath, any_path
from tests.beam_ros.bags.small_bags import write_experiment

fsspec = pytest.importorskip("fsspec", reason="the extra `remote` is not installed")


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    return write_experiment(tmp_path_factory.mktemp("bags") / "run", batches=200)


@pytest.fixture
def in_memory(experiment):
    store = fsspec.filesystem("memory")
    store.put(str(experiment), "/lab/run", recursive=True)
    yield "memory://lab/run"
    store.rm("/lab", recursive=True)


@pytest.fixture(scope="module")
def object_store(experiment):
    """The URL of the bag in a store that runs as a process of its own and counts what is asked of it."""
    if not all(importlib.util.find_spec(name) for name in ("s3fs", "moto", "flask")):
        pytest.skip('needs an object store: pip install "s3fs" "moto[server]"')
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    keys = {"AWS_ACCESS_KEY_ID": "any", "AWS_SECRET_ACCESS_KEY": "any", "AWS_DEFAULT_REGION": "us-east-1"}
    endpoint = f"http://127.0.0.1:{port}"
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    before = dict(os.environ)
    os.environ.update(keys, AWS_ENDPOINT_URL=endpoint, FSSPEC_S3_ENDPOINT_URL=endpoint)
    try:
        for _ in range(300):
            try:
                urllib.request.urlopen(endpoint, timeout=1).close()
                break
            except OSError:
                time.sleep(0.1)
        store = fsspec.filesystem("s3", endpoint_url=endpoint)
        store.mkdir("lab")
        store.put(str(experiment), "lab/run", recursive=True)
        fsspec.config.conf["s3"] = {"endpoint_url": endpoint}
        yield "s3://lab/run"
    finally:
        server.terminate()
        server.wait(timeout=20)
        fsspec.config.conf.pop("s3", None)
        os.environ.clear()
        os.environ.update(before)


def _same(url, experiment):
    with Bag(url) as there, Bag(experiment) as here:
        assert there.topics == here.topics
        assert there.excitation_info() == here.excitation_info()
        np.testing.assert_array_equal(there.hub_samples().positions, here.hub_samples().positions)
        np.testing.assert_array_equal(there.displacements().positions, here.displacements().positions)


def test_a_bag_in_memory_gives_the_answers_of_the_disk(in_memory, experiment):
    _same(in_memory, experiment)
    _same(f"{in_memory}/run_0.mcap", experiment)


def test_a_bag_in_an_object_store_gives_the_answers_of_the_disk(object_store, experiment):
    _same(object_store, experiment)


def test_info_of_a_bag_elsewhere_reads_its_index_and_a_part_on_request(object_store, capsys):
    assert main(["info", object_store]) == 0
    said = capsys.readouterr().out
    assert re.search(r"/hub/measured +200 ", said)
    assert "only the index was read" in said
    assert "samples over" not in said
    assert main(["info", object_store, "--from", "1", "--to", "2"]) == 0
    assert "/hub/measured: 1000 samples over 0.999 s" in capsys.readouterr().out


def test_a_part_of_a_bag_elsewhere_is_a_few_requests_of_little(in_memory, experiment):
    asked = []

    class Counted(RemotePath):
        def open(self, mode="rb"):
            stream = super().open(mode)
            read = stream.read

            def counted(size=-1):
                data = read(size)
                asked.append(len(data))
                return data

            stream.read = counted
            return stream

        def __truediv__(self, name):
            return Counted(f"{self}/{name}", self._store)

    with Bag(Counted(in_memory), start_s=1.0, end_s=1.5) as bag:
        opened = sum(asked)
        assert len(bag.hub_samples().positions) == pytest.approx(500, abs=20)
    size = (experiment / "run_0.mcap").stat().st_size
    assert sum(asked) - opened < 0.55 * size  # three chunks of eight


@pytest.mark.parametrize(
    ("url", "error", "words"),
    [
        ("memory://nothing/here", BagNotFoundError, "does not exist"),
        ("what://lab/run", UsageError, "cannot be reached"),
    ],
)
def test_what_cannot_be_reached_is_said_with_a_remedy(url, error, words):
    with pytest.raises(error, match=words):
        Bag(url)


def test_what_a_stores_library_raises_is_one_line(tmp_path, capsys):
    (tmp_path / "no.zip").write_text("no archive")
    assert main(["info", f"zip://run.mcap::{tmp_path}/no.zip"]) == 2
    said = capsys.readouterr().err
    assert "cannot be reached" in said
    assert len(said.strip().splitlines()) == 1


def test_a_cut_bag_elsewhere_is_refused(in_memory):
    store = fsspec.filesystem("memory")
    store.pipe("/lab/run/run_0.mcap", store.cat("/lab/run/run_0.mcap")[:-50])
    with pytest.raises(BagTruncatedError):
        Bag(in_memory)


def test_parts_of_a_path_are_those_of_its_url():
    path = any_path("memory://lab/run/run_0.mcap")
    assert (path.name, path.stem, path.suffix) == ("run_0.mcap", "run_0", ".mcap")
    assert str(path.parent / "metadata.yaml") == "memory://lab/run/metadata.yaml"
    assert any_path("lab/run") == Path("lab/run")


def test_the_summary_of_a_part_says_so(in_memory):
    with Bag(in_memory, end_s=1.0) as bag:
        info = summarise(bag)
    assert "only a part" in info.remark
    assert info.to_dict()["path"] == in_memory
