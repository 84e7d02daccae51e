from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.line.framing import MAX_PAYLOAD, FrameDecoder, cobs_decode, cobs_encode, encode_frame

PAYLOAD = bytes(range(40)) + b"\0\0" + bytes(255 for _ in range(260))


@pytest.mark.parametrize(
    ("data", "encoded"),
    [
        # The examples of Cheshire & Baker's article and its usual extensions.
        (b"", "01"),
        (b"\0", "0101"),
        (b"\0\0", "010101"),
        (b"\x11\x22\0\x33", "0311220233"),
        (b"\x11\x22\x33\x44", "0511223344"),
        (b"\x11\0\0\0", "0211010101"),
        (bytes(range(1, 255)), "ff" + bytes(range(1, 255)).hex()),
        (b"\0" + bytes(range(1, 255)), "01ff" + bytes(range(1, 255)).hex()),
        (bytes(range(1, 256)), "ff" + bytes(range(1, 255)).hex() + "02ff"),
        (bytes(range(2, 256)) + b"\0", "ff" + bytes(range(2, 256)).hex() + "0101"),
        (bytes(range(3, 256)) + b"\0\x01", "fe" + bytes(range(3, 256)).hex() + "0201"),
    ],
)
def test_cobs_gives_the_published_encodings(data, encoded):
    assert cobs_encode(data).hex() == encoded
    assert cobs_decode(bytes.fromhex(encoded)) == data


@given(st.binary(max_size=1200))
@settings(deadline=None, derandomize=True)
def test_cobs_survives_the_round_trip_without_a_zero_byte(data):
    encoded = cobs_encode(data)
    assert 0 not in encoded
    assert len(encoded) <= len(data) + len(data) // 254 + 1
    assert cobs_decode(encoded) == data


@pytest.mark.parametrize("data", [b"\x02", b"\x05abc", b"\x01\0\x01", b"\0"])
def test_broken_cobs_is_refused(data):
    with pytest.raises(HubProtocolError):
        cobs_decode(data)


@given(st.lists(st.binary(min_size=1, max_size=300), max_size=8), st.integers(1, 50))
@settings(deadline=None, derandomize=True)
def test_frames_come_out_whatever_the_pieces(payloads, size):
    stream = b"".join(encode_frame(payload) for payload in payloads)
    decoder = FrameDecoder()
    found = [p for k in range(0, len(stream), size) for p in decoder.feed(stream[k : k + size])]
    assert found == payloads
    assert (decoder.n_good, decoder.n_bad) == (len(payloads), 0)


def test_every_truncation_is_noticed_and_the_next_frame_passes():
    frame, follower = encode_frame(PAYLOAD), encode_frame(b"next")
    for length in range(1, len(frame) - 1):
        decoder = FrameDecoder()
        # Cut at the end, and cut at the beginning.
        assert decoder.feed(frame[:length] + b"\0" + follower) == [b"next"]
        assert decoder.feed(frame[length + 1 :] + follower) == [b"next"]


def test_every_flipped_bit_is_noticed_and_a_later_frame_passes():
    frame, follower = encode_frame(PAYLOAD), encode_frame(b"next")
    for bit in range(8 * len(frame)):
        broken = bytearray(frame)
        broken[bit // 8] ^= 1 << (bit % 8)
        found = FrameDecoder().feed(b"noise" + bytes(broken) + follower)
        # The outer zeros only part the frame from its neighbours; inside, every bit matters.
        is_inside = 0 < bit // 8 < len(frame) - 1
        assert found[-1] == b"next"
        assert (PAYLOAD not in found) or not is_inside


def test_noise_between_frames_costs_at_most_the_frame_it_touches():
    rng = random.Random(4)
    decoder = FrameDecoder()
    for k in range(300):
        payload = rng.randbytes(rng.randint(1, 60))
        noise = rng.randbytes(rng.randint(0, 3000))
        assert decoder.feed(noise + encode_frame(payload))[-1] == payload, k


@given(st.binary(max_size=4000))
@settings(deadline=None, derandomize=True)
def test_nothing_on_the_line_raises(data):
    decoder = FrameDecoder()
    decoder.feed(data)
    assert decoder.feed(encode_frame(b"x")) == [b"x"]


def test_an_endless_run_without_a_zero_does_not_fill_the_memory():
    decoder = FrameDecoder()
    for _ in range(1000):
        decoder.feed(b"\x55" * 1000)
    assert len(decoder._pending) <= 2 * MAX_PAYLOAD
    assert decoder.feed(encode_frame(b"x")) == [b"x"]
    assert decoder.n_bad == 1


@pytest.mark.parametrize("payload", [b"", bytes(MAX_PAYLOAD + 1)])
def test_a_payload_without_a_frame_is_refused(payload):
    with pytest.raises(HubProtocolError, match="payload of"):
        encode_frame(payload)
