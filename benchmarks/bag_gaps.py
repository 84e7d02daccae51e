"""What a bag may lose: messages of the hub and frames, and where the poles then are against the whole bag's.

    python -m benchmarks.bag_gaps [--rigs WORD] [--losses WORD] [--seed S] [--json FILE]

Three rigs are simulated: the default one, a long soft strip that hangs, and a hub that is driven by force. Of every
bag copies are made that lack 1 to 50 messages of the hub (20 ms each, of what it measured and of what it applied
alike), one by one or in one piece, 1 to 30 % of the frames, at random, in pieces or every so many, and both.
`beam identify` then answers as always. Printed are for every copy the largest difference of a frequency or damping
ratio from the whole bag's, in the whole bag's standard deviations, how far the copy's own deviations grew, and
whether the loss is named. Exit status 1 where a mode is missing or new, or a loss is not named. A mode that a sweep
passed in a hole may be missed, where a note says so.

A copy with less data cannot agree better than noise allows: where the standard deviation grows by a factor g, an
efficient estimate differs by sqrt(g^2 - 1) standard deviations of the whole bag's. That is printed beside it, as the
rms over all parameters, and `beyond` counts the differences of more than one standard deviation.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import IdentificationError
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.errors import UsageError
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig

HUB = ("hub/measured", "hub/applied")
FRAMES = "beam/displacement"
HIDDEN = "may be missed"
RIGS: Mapping[str, Mapping[str, Any]] = {
    "default": {"excitation.duration": 8.0, "excitation.still": 3.0},
    # Another thickness, gravity and heights than the default rig's, and half a second of swing in the first mode.
    "long soft strip": {
        "beam.length": 0.5,
        "beam.thickness": 0.0004,
        "beam.gravity": "hanging",
        "markers.heights": [0.015, 0.33, 0.47],
        "excitation.start_frequency": 0.7,
        "excitation.end_frequency": 40.0,
        "excitation.acceleration": 0.2,
        "excitation.duration": 10.0,
        "excitation.still": 4.0,
    },
    "driven by force": {
        "hub.command_mode": "effort",
        "excitation.acceleration": 0.2,
        "excitation.duration": 8.0,
        "excitation.still": 3.0,
    },
}
MESSAGES = (1, 5, 20, 50)
SHARES = (0.01, 0.1, 0.3)
_EDGE = 3  # messages and frames at both ends that stay: what ends a record is no gap
_PIECE = 8  # frames

Lost = dict[str, set[int]]


def one_by_one(rng: np.random.Generator, n: int, count: int) -> set[int]:
    """Return so many numbers below n."""
    return set((_EDGE + rng.choice(n - 2 * _EDGE, count, replace=False)).tolist())


def in_one_piece(rng: np.random.Generator, n: int, count: int) -> set[int]:
    """Return so many numbers below n that follow each other."""
    first = int(rng.integers(_EDGE, n - _EDGE - count))
    return set(range(first, first + count))


def in_pieces(rng: np.random.Generator, n: int, count: int) -> set[int]:
    """Return about so many numbers below n, some of which follow each other."""
    starts = rng.choice((n - 2 * _EDGE) // _PIECE, max(count // _PIECE, 1), replace=False)
    return {_EDGE + _PIECE * int(start) + k for start in starts for k in range(min(_PIECE, count))}


def every_so_many(rng: np.random.Generator, n: int, count: int) -> set[int]:
    """Return so many numbers below n at equal distances."""
    return set(range(_EDGE + int(rng.integers(n // count)), n - _EDGE, n // count))


Pattern = Callable[[np.random.Generator, int, int], set[int]]
OF_HUB: Mapping[str, Pattern] = {"one by one": one_by_one, "in one piece": in_one_piece}
OF_FRAMES: Mapping[str, Pattern] = {
    "at random": one_by_one,
    "in pieces": in_pieces,
    "every so many": every_so_many,
}


def losses(counts: Mapping[str, int], seed: int, begun: Mapping[str, int]) -> Iterator[tuple[str, Lost]]:
    """Yield what is lost, with its name.

    Parameters
    ----------
    counts : mapping -- messages of every topic
    seed : int
    begun : mapping -- the first message of every topic that a record of the experiment has
    """
    rng = np.random.default_rng([12, seed])

    def hub(pattern: str, n_lost: int) -> Lost:
        here = OF_HUB[pattern](rng, counts[HUB[0]] - begun[HUB[0]], n_lost)
        return {topic: {begun[topic] + k for k in here} for topic in HUB}

    def frames(pattern: str, share: float) -> Lost:
        n = counts[FRAMES] - begun[FRAMES]
        return {FRAMES: {begun[FRAMES] + k for k in OF_FRAMES[pattern](rng, n, max(round(share * n), 1))}}

    for pattern in OF_HUB:
        for n_lost in MESSAGES:
            yield f"hub {n_lost} {pattern}", hub(pattern, n_lost)
    for pattern in OF_FRAMES:
        for share in SHARES:
            yield f"frames {100 * share:.0f} % {pattern}", frames(pattern, share)
    for of_hub, n_lost in (("one by one", 50), ("in one piece", 10)):
        for of_frames in OF_FRAMES:
            name = f"hub {n_lost} {of_hub}, frames 30 % {of_frames}"
            yield name, hub(of_hub, n_lost) | frames(of_frames, 0.3)


@dataclass(frozen=True)
class Told:
    """What came of one copy.

    Attributes
    ----------
    rig, loss : str
    n_modes : int -- 0: refused
    differences : tuple of float -- of frequencies and damping ratios, in the whole bag's standard deviations
    grown : tuple of float -- standard deviations over the whole bag's
    is_named : bool -- notes or warnings speak of the loss
    said : str -- the notes, or why it was refused
    seconds : float
    """

    rig: str
    loss: str
    n_modes: int
    differences: tuple[float, ...]
    grown: tuple[float, ...]
    is_named: bool
    said: str
    seconds: float


def numbers_of(content: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies and damping ratios, and their standard deviations."""
    pairs = [
        (mode[key], mode[sd])
        for mode in content["modes"]
        for key, sd in (
            ("frequency_hz", "frequency_sd_hz"),
            ("damping_ratio", "damping_ratio_sd"),
        )
    ]
    return np.array([own for own, _ in pairs]), np.array([sd for _, sd in pairs])


class Whole:
    """A whole bag: its messages, and what is identified from it."""

    def __init__(self, name: str, folder: Path, seed: int) -> None:
        self.name, self._folder = name, folder
        rig = Rig.from_file().with_values({**RIGS[name], "simulation.seed": seed})
        simulate(rig, folder / "whole")
        with Bag(folder / "whole") as bag:
            self._messages = [(own.topic.lstrip("/"), own.receive_ns, own.data) for own in bag.raw_messages()]
        self.content = identification_of_bags(folder / "whole").content
        topics = [topic for topic, _, _ in self._messages]
        self.counts = {topic: topics.count(topic) for topic in (*HUB, FRAMES)}
        # Before the excitation begins nothing is used.
        start = topics.index("excitation/info")
        self.begun = {topic: topics[:start].count(topic) for topic in self.counts}

    def without(self, lost: Lost, number: int) -> Path:
        """Write a copy without some messages."""
        path, seen = self._folder / str(number), dict.fromkeys(self.counts, -1)
        with BagWriter(path) as copy:
            for topic, receive_ns, data in self._messages:
                if topic in seen:
                    seen[topic] += 1
                if seen.get(topic, 0) not in lost.get(topic, ()):
                    copy.write(topic, receive_ns, data)
        return path

    def told_without(self, loss: str, lost: Lost, number: int) -> Told:
        """Identify a copy."""
        path, start = self.without(lost, number), time.perf_counter()
        try:
            content = identification_of_bags(path).content
        except (IdentificationError, UsageError) as err:
            is_named = "gap" in str(err) or "frames" in str(err)
            return Told(self.name, loss, 0, (), (), is_named, str(err), time.perf_counter() - start)
        seconds = time.perf_counter() - start
        said = " ".join((*content["notes"], *content["warnings"]))
        is_named = all(
            word in said for word, is_lost in (("gap", HUB[0] in lost), ("frames", FRAMES in lost)) if is_lost
        )
        n_modes, differences, grown = len(content["modes"]), np.empty(0), np.empty(0)
        if n_modes == len(self.content["modes"]):
            (values, sds), (own, own_sds) = numbers_of(self.content), numbers_of(content)
            differences, grown = (own - values) / sds, own_sds / sds
        return Told(self.name, loss, n_modes, tuple(differences), tuple(grown), is_named, said, seconds)


def told_in_words(own: Told, n_modes: int) -> str:
    """Return a line of the table."""
    name = "" if own.is_named else "  NOT NAMED"
    if not own.differences:
        return f"{own.n_modes} modes instead of {n_modes}: {own.said[:150]}{name}"
    worst, grown = max(map(abs, own.differences)), max(own.grown)
    rms = float(np.sqrt(np.mean(np.square(own.differences))))
    due = float(np.sqrt(np.mean(np.maximum(np.square(own.grown) - 1.0, 0.0))))
    figures = f"largest {worst:5.2f} sd, rms {rms:5.2f} (due {due:4.2f}), sd grown {grown:5.2f}"
    return f"{figures}, {own.seconds:4.1f} s{name}"


def main() -> int:
    """Simulate, lose, identify and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rigs", default="", help="a part of their names")
    parser.add_argument("--losses", default="", help="a part of their names")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="write every copy's figures here, too")
    asked = parser.parse_args()
    told: list[Told] = []
    expected: dict[str, int] = {}
    for name in RIGS:
        if asked.rigs not in name:
            continue
        with tempfile.TemporaryDirectory() as folder:
            whole = Whole(name, Path(folder), asked.seed)
            expected[name] = len(whole.content["modes"])
            print(f"{name}: {expected[name]} modes, {whole.counts}", flush=True)
            for number, (loss, lost) in enumerate(losses(whole.counts, asked.seed, whole.begun)):
                if asked.losses in loss:
                    told.append(whole.told_without(loss, lost, number))
                    print(f"  {loss:46s} {told_in_words(told[-1], expected[name])}", flush=True)
    differences = np.abs([value for own in told for value in own.differences])
    other = [own for own in told if own.n_modes != expected[own.rig]]
    hidden = [own for own in other if HIDDEN in own.said]
    unnamed = [own for own in told if not own.is_named]
    within = sum(bool(own.differences) and max(map(abs, own.differences)) < 1.0 for own in told)
    print(
        f"{len(told)} copies: {within} with all poles within 1 sd of the whole bag's, {len(other)} with another "
        f"number of modes ({len(hidden)} of them said to be hidden by a hole), {len(unnamed)} losses "
        f"not named; {np.count_nonzero(differences > 1.0)} of {len(differences)} differences beyond 1 sd, "
        f"the largest {np.max(differences, initial=0.0):.2f} sd"
    )
    if asked.json:
        asked.json.write_text(json.dumps([asdict(own) for own in told], indent=1) + "\n")
    return 1 if len(other) > len(hidden) or unnamed else 0


if __name__ == "__main__":
    sys.exit(main())
