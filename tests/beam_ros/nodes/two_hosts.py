"""Two hosts on one machine: `unshare --map-root-user --net --mount python -m tests.beam_ros.nodes.two_hosts FOLDER`.

Each is a network namespace with an address, a loopback and shared memory of its own, and a cable is between them. The
controller's host runs the emulated controller and its driver, the desk's host everything else. Prints what the
services answered, and the nodes' exit statuses, as JSON.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from beam_ros.process.environment import child_environment
from beam_ros.process.executables import command

QUICK = ("excitation.duration:=4.0", "excitation.still:=1.0", "hub.watchdog:=1.0")
PATIENCE_S = 60.0


class Host:
    """A network namespace with an end of the cable, and a memory of its own that its processes share."""

    def __init__(self, name: str, address: str) -> None:
        for line in (
            f"ip netns add {name}",
            f"ip link set {name} netns {name}",
            f"ip -n {name} address add {address}/24 dev {name}",
            f"ip -n {name} link set lo up",
            f"ip -n {name} link set {name} up",
            f"ip -n {name} route add 224.0.0.0/4 dev {name}",
        ):
            subprocess.run(line.split(), check=True)
        hold = "mount -t tmpfs none /dev/shm && echo ready && exec sleep infinity"
        self._holder = subprocess.Popen(
            ["ip", "netns", "exec", name, "unshare", "--mount", "sh", "-c", hold], stdout=subprocess.PIPE
        )
        assert self._holder.stdout is not None
        assert self._holder.stdout.readline() == b"ready\n"

    def words(self, words: list[str]) -> list[str]:
        """Return the command line that runs another one here."""
        return ["nsenter", f"--target={self._holder.pid}", "--net", "--mount", f"--wd={os.getcwd()}", *words]

    def close(self) -> None:
        """End it."""
        self._holder.kill()
        self._holder.wait()


def main() -> int:
    """Run a short experiment from the desk."""
    folder = Path(sys.argv[1])
    environment = child_environment(
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_DOMAIN_ID": "0", "ROS_LOG_DIR": str(folder / "ros")}
    )
    for line in ("mount -t tmpfs none /run", "ip link add controller type veth peer name desk"):
        subprocess.run(line.split(), check=True)
    hosts = {"controller": Host("controller", "10.87.0.1"), "desk": Host("desk", "10.87.0.2")}
    nodes = (
        ("controller", "firmware_emulator", (f"emulator.port_link:={folder / 'port'}",)),
        ("controller", "hub_driver", (f"serial.port:={folder / 'port'}", "serial.patience:=30.0")),
        ("desk", "excitation_generator", ()),
        ("desk", "bag_recorder", (f"recorder.path:={folder / 'bag'}",)),
    )
    running: dict[str, subprocess.Popen[bytes]] = {}
    answers: dict[str, str] = {}
    try:
        for host, name, own in nodes:
            given = [word for parameter in (*QUICK, *own) for word in ("-p", parameter)]
            with (folder / f"{name}.log").open("wb") as log:
                running[name] = subprocess.Popen(
                    hosts[host].words([*command(name), "--ros-args", *given]),
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                )
        time.sleep(8.0)
        for service, *value in (("hub/home",), ("hub/enable", "true"), ("excitation/start",)):
            ended = subprocess.run(
                hosts["desk"].words(
                    [*command("beam"), "call", service, *value, "--timeout", f"{PATIENCE_S}"]
                ),
                env=environment,
                capture_output=True,
                text=True,
                timeout=PATIENCE_S + 30.0,
                check=False,
            )
            answers[service] = ended.stdout + ended.stderr
        time.sleep(10.0)
    finally:
        for process in reversed(running.values()):
            process.send_signal(signal.SIGINT)
        statuses = {name: process.wait(20.0) for name, process in running.items()}
        for made in hosts.values():
            made.close()
    sys.stdout.write(json.dumps({"answers": answers, "statuses": statuses}))
    return 0


if __name__ == "__main__":
    os.environ.pop("ROS_LOCALHOST_ONLY", None)
    sys.exit(main())
