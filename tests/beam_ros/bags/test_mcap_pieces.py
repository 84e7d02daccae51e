"""Pieces of an MCAP file: everything whole is found, whatever stands between; checked against mcap's own reader."""

from __future__ import annotations

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from beam_ros.bags.errors import NotABagError
from beam_ros.bags.mcap_pieces import chunk_content, damage_of, find_pieces, open_file, records_of


def _write(path, *, compression=CompressionType.NONE, use_chunking=True):
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, chunk_size=2000, use_chunking=use_chunking)
        writer.start("ros2")
        channel = writer.register_channel("/text", "cdr", writer.register_schema("a/msg/B", "ros2msg", b""))
        for k in range(300):
            writer.add_message(channel, k, bytes([k % 256]) * 50, k)
        writer.finish()
    return path


def _messages(data):
    pieces = find_pieces(data)
    found = [data[start + 22 : end] for start, end in pieces.messages]
    for chunk in pieces.chunks:
        records = records_of(chunk_content(data, chunk))
        found += [record[22:] for opcode, record in records if opcode == Opcode.MESSAGE]
    return found


@pytest.mark.parametrize("compression", list(CompressionType))
def test_the_pieces_of_a_whole_file_are_all_that_is_in_it(tmp_path, compression):
    path = _write(tmp_path / "a.mcap", compression=compression)
    data = open_file(path)
    pieces = find_pieces(data)
    with path.open("rb") as stream:
        assert _messages(data) == [message.data for _, _, message in make_reader(stream).iter_messages()]
    assert not list(damage_of(data, pieces))
    assert pieces.indexed == pieces.statistics.channel_message_counts == {1: 300}


def test_bare_messages_behind_damage_are_found_again(tmp_path):
    data = bytearray(_write(tmp_path / "a.mcap", use_chunking=False).read_bytes())
    first = bytes(data).index(bytes([100]) * 50)
    data[first - 23] ^= 8  # the length of message 100
    found = _messages(bytes(data))
    assert found == [bytes([k % 256]) * 50 for k in range(300) if k != 100]


def test_an_index_that_looks_like_a_message_is_none(tmp_path):
    data = bytearray(_write(tmp_path / "a.mcap").read_bytes())
    index = find_pieces(bytes(data)).chunks[2].end
    assert data[index] == Opcode.MESSAGE_INDEX
    data[index] = Opcode.MESSAGE
    assert len(_messages(bytes(data))) == 300
    assert any(f"from byte {index}" in text for text in damage_of(bytes(data), find_pieces(bytes(data))))


def test_an_empty_file_is_refused(tmp_path):
    (tmp_path / "empty.mcap").touch()
    with pytest.raises(NotABagError, match="is empty"):
        open_file(tmp_path / "empty.mcap")


@pytest.mark.parametrize(
    ("checksum", "said"), [(b"\0\0\0\0", []), (b"\1\2\3\4", ["the summary has a wrong checksum"])]
)
def test_a_summary_without_a_checksum_is_whole_and_one_with_another_is_not(tmp_path, checksum, said):
    data = bytearray(_write(tmp_path / "bag.mcap").read_bytes())
    data[-12:-8] = checksum  # the last field of the footer, before the magic bytes
    assert list(damage_of(bytes(data), find_pieces(bytes(data)))) == said
