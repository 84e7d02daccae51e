"""Checksums against what coreutils and FIPS 180 say."""

from __future__ import annotations

from pathlib import Path

from beam_ros.process.checksums import checksum


def test_the_checksum_is_that_of_the_standard_also_over_many_blocks(tmp_path: Path) -> None:
    short, long = tmp_path / "short", tmp_path / "long"
    short.write_bytes(b"abc")  # FIPS 180-2, B.1
    assert checksum(short) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    long.write_bytes(b"a" * 3_000_000)  # `head -c 3000000 /dev/zero | tr '\\0' a | sha256sum`
    assert checksum(long) == "2a152c894398719c0570f83fac34ac03a0f6e8e474b995c2403aa5434f7b9dd4"


def test_several_files_are_summed_as_one_in_their_order(tmp_path: Path) -> None:
    whole, first, second = (tmp_path / name for name in ("whole", "first", "second"))
    whole.write_bytes(b"abcdef")
    first.write_bytes(b"abc")
    second.write_bytes(b"def")
    assert checksum(first, second) == checksum(whole) != checksum(second, first)
