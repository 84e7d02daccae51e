"""Where an axis moves and where it rests."""

from __future__ import annotations

import numpy as np

from beam_ident import InputSignal, OutputSignal
from beam_ident.axis.axis_record import AxisRecord


def test_the_noise_of_a_piece_has_no_part_in_where_it_begins_and_ends() -> None:
    noise = 5e-6
    # 300 moves of 0.1 m in 0.8 s there and back, with rests of 0.2 s: what is left of 300 is a mean of 0 +- 1 below.
    s = np.arange(800) / 800.0
    move = 0.1 * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
    rest = np.zeros(200)
    truth = np.concatenate([rest, *[move, rest + 0.1, 0.1 - move, rest] * 150])
    error = noise * np.random.default_rng(0).standard_normal(len(truth))
    record = AxisRecord(
        InputSignal("force", "N", (0.0, 1e-3), np.zeros(len(truth))),
        OutputSignal("position", "m", (0.0, 1e-3), truth + error),
    )
    assert len(record.pieces) == 300
    way = np.sign([truth[piece.samples][-1] - truth[piece.samples][0] for piece in record.pieces])
    edges = np.array([[*error[piece.samples][:8], *error[piece.samples][-8:]] for piece in record.pieces])
    z = np.sum(way[:, None] * edges, axis=0) / noise / np.sqrt(len(record.pieces))
    assert np.max(np.abs(z)) < 4.0


def test_a_piece_begins_where_the_axis_surely_moves() -> None:
    # At rest for ten samples, too few for a rest, then off at once: a velocity of about zero has no estimate.
    t = 2e-3 * np.arange(2000)
    truth = 0.05 * np.sin(3.0 * np.maximum(t - 0.02, 0.0)) ** 2
    noise = 1e-5 * np.random.default_rng(0).standard_normal(len(t))
    record = AxisRecord(
        InputSignal("force", "N", (0.0, 2e-3), np.zeros(len(t))),
        OutputSignal("position", "m", (0.0, 2e-3), truth + noise),
    )
    first = record.pieces[0].samples.start
    speed = np.gradient(truth, t)
    assert 10 < first < 60
    assert speed[first] > 0.02 * np.sqrt(np.mean(np.square(speed)))
