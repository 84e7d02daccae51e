from __future__ import annotations

import numpy as np
import pytest

from beam_ident.noise.shared_noise import SharedNoise

N = 4000
TRUE = np.array([[1.0, 0.9, -0.5], [0.9, 1.0, -0.4], [-0.5, -0.4, 1.0]])
LEVELS = np.array([1e-6, 3.0, 0.2])


def drawn(correlation: np.ndarray, seed: int = 0, n: int = N) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return LEVELS * (rng.standard_normal((n, 3)) @ np.linalg.cholesky(correlation).T)


def seen_by_turns(seed: int = 1) -> tuple[list[np.ndarray], np.ndarray]:
    """Return noise of outputs of which each misses some instants, and the rows that are there."""
    is_seen = np.random.default_rng(seed).random((N, 3)) < [0.9, 0.7, 0.8]
    values = drawn(TRUE)
    rows = np.where(is_seen, np.cumsum(is_seen, axis=0) - 1, -1)
    return [values[is_seen[:, j], j] for j in range(3)], rows


def whole(n: int = N) -> np.ndarray:
    return np.tile(np.arange(n)[:, None], (1, 3))


def places(white: list[np.ndarray]) -> list[slice]:
    return [slice(0, len(own)) for own in white]


def test_the_correlation_is_found_whatever_the_levels_and_with_gaps():
    for white, rows in ((list(drawn(TRUE).T), whole()), seen_by_turns()):
        found = SharedNoise.of(white, rows)
        # (1 - r^2) / sqrt(n) of each, three of them in the worse case.
        assert found.correlation == pytest.approx(TRUE, abs=0.05)
        assert np.diag(found.correlation) == pytest.approx(np.ones(3), abs=1e-12)
        assert found.share(0) == pytest.approx(1.0 - 1.0 / np.linalg.inv(TRUE)[0, 0], abs=0.02)


def test_outputs_that_share_nothing_are_left_alone():
    n = 500
    found = [SharedNoise.of(list(drawn(np.eye(3), seed, n).T), whole(n)) for seed in range(300)]
    # BIC asks three correlations for 3 log(500): one in 4000 by chance.
    assert found.count(None) >= 299


def test_one_output_or_instants_that_are_never_common_share_nothing():
    assert SharedNoise.of([np.ones(50)], np.arange(50)[:, None]) is None
    apart = np.full((100, 2), -1)
    apart[::2, 0] = apart[1::2, 1] = np.arange(50)
    values = np.random.default_rng(2).standard_normal(50)
    assert SharedNoise.of([values, values], apart) is None


def test_what_is_unshared_is_independent_with_gaps_too():
    white, rows = seen_by_turns()
    white = [own / level for own, level in zip(white, LEVELS, strict=True)]
    found = SharedNoise.of(white, rows)
    left = found.unshared([own[:, None] for own in white], places(white))
    assert [own.shape for own in left] == [(len(own), 1) for own in white]
    for j in range(3):
        assert np.var(left[j]) == pytest.approx(1.0, abs=0.1)
        for k in range(j):
            both = (rows[:, j] >= 0) & (rows[:, k] >= 0)
            pair = left[j][rows[both, j], 0], left[k][rows[both, k], 0]
            assert abs(np.corrcoef(pair)[0, 1]) < 4.0 / np.sqrt(np.count_nonzero(both))


def test_pieces_are_what_the_whole_is():
    white, rows = seen_by_turns()
    found, every = SharedNoise.of(white, rows), [own[:, None] for own in white]
    whole_rows, excess = found.unshared(every, places(white)), found.excess(every, places(white))
    cut = [int(np.count_nonzero(rows[: N // 3, j] >= 0)) for j in range(3)]
    parts = [[slice(0, at) for at in cut], [slice(at, len(own)) for at, own in zip(cut, white, strict=True)]]
    pieces = [[own[part] for own, part in zip(every, here, strict=True)] for here in parts]
    joined = zip(*(found.unshared(own, here) for own, here in zip(pieces, parts, strict=True)), strict=True)
    for own, both in zip(whole_rows, joined, strict=True):
        assert np.array_equal(own, np.concatenate(both))
    assert sum(found.excess(own, here) for own, here in zip(pieces, parts, strict=True)) == pytest.approx(
        excess
    )


def test_the_excess_is_what_the_correlation_adds_to_the_score():
    white, rows = seen_by_turns()
    found = SharedNoise.of(white, rows)
    rng = np.random.default_rng(3)
    designs = [rng.standard_normal((len(own), 2)) for own in white]
    expected = np.zeros((2, 2))
    for instant in rows:
        for j in range(3):
            for k in range(3):
                if j != k and instant[j] >= 0 and instant[k] >= 0:
                    pair = np.outer(designs[j][instant[j]], designs[k][instant[k]])
                    expected += found.correlation[j, k] * pair
    assert found.excess(designs, places(white)) == pytest.approx(expected)


def test_outputs_that_say_the_same_twice_can_be_weighed():
    values = np.random.default_rng(4).standard_normal(N)
    found = SharedNoise.of([values, values, values], whole())
    assert np.all(np.isfinite(np.linalg.inv(found.correlation)))
