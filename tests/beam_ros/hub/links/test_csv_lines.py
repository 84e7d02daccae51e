"""Lines of numbers out of whatever a port brings: every cut, every damage, headings and remarks."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.links.csv_lines import CsvReader, split_row

ROWS = [(1000.0 * k, 17.0 - k, 0.25 * k) for k in range(1, 30)]
TEXT = b"".join(b"%d,%d,%.2f\r\n" % row for row in ROWS)


@pytest.mark.parametrize(
    ("line", "row"),
    [
        (b"1,2,3", (1.0, 2.0, 3.0)),
        (b" 1.5;-2e-3 ", (1.5, -0.002)),
        (b"1\t2", (1.0, 2.0)),
        (b"1   2  3", (1.0, 2.0, 3.0)),
        (b"4.5", (4.5,)),
        (b"t,x", None),
        (b"1,,3", None),
        (b"1,nan", None),
        (b"1,inf", None),
        (b"", None),
        (b"1,2\xff", None),
        (b"# ready", None),
    ],
)
def test_a_row_is_numbers_and_nothing_else(line: bytes, row: tuple[float, ...] | None) -> None:
    assert split_row(line) == row


@pytest.mark.parametrize("size", [1, 2, 3, 7, 64, 1000])
def test_rows_are_the_same_however_the_bytes_are_cut(size: int) -> None:
    reader = CsvReader()
    rows = [row for at in range(0, len(TEXT), size) for row in reader.feed(TEXT[at : at + size])]
    # The first line may be the end of one.
    assert rows == ROWS[1:]
    assert reader.n_bad == 0


def test_headings_remarks_and_noise_are_left_out_and_counted() -> None:
    reader = CsvReader()
    lines = TEXT.split(b"\r\n")[:-1]
    lines[3:3] = [b"time_us,position,force", b"", b"ok", b"\x00\x8a\xf3,1,2", b"9000,4", b"x" * 300]
    rows = reader.feed(b"\n".join(lines) + b"\n")
    assert rows == ROWS[1:]
    assert reader.n_bad == 5


def test_a_stream_without_an_end_of_line_takes_no_memory() -> None:
    reader = CsvReader()
    for _ in range(1000):
        assert reader.feed(b"7" * 100) == []
    assert len(reader._rest) <= 1124
    assert reader.feed(b"\n" + TEXT) == ROWS


def test_random_bytes_never_raise_and_a_damaged_line_costs_itself_alone() -> None:
    rng = np.random.default_rng(5)
    for _ in range(300):
        data = bytearray(TEXT)
        at = int(rng.integers(0, len(data)))
        data[at] = int(rng.integers(0, 256))
        rows = CsvReader().feed(bytes(data))
        assert len(set(ROWS[1:]) - set(rows)) <= 2
    CsvReader().feed(rng.integers(0, 256, 100_000, dtype=np.uint8).tobytes())
