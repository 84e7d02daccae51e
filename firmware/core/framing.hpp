// Frames on a line of bytes: 00 COBS(payload crc32) 00, as in docs/protocol.md.

#ifndef BEAM_CORE_FRAMING_HPP
#define BEAM_CORE_FRAMING_HPP

#include <cstddef>
#include <cstdint>

namespace beam {

/// Longest payload [bytes].
constexpr std::size_t max_payload = 2048;
/// Longest COBS part of a frame: payload, CRC, and one byte for every 254 begun.
constexpr std::size_t max_encoded = max_payload + 4 + (max_payload + 4) / 254 + 1;
/// Longest frame, with its zero bytes.
constexpr std::size_t max_frame = max_encoded + 2;

/// CRC-32 of Ethernet and zlib; "123456789" gives CBF43926.
std::uint32_t crc32(const std::uint8_t* data, std::size_t size);

/// Writes a payload of 1 to `max_payload` bytes as one frame; returns the frame's size.
std::size_t encode_frame(const std::uint8_t* payload, std::size_t size, std::uint8_t* frame);

/// Finds the payloads in a stream of bytes.
class FrameDecoder {
public:
    /// Takes one byte. Returns the size of the payload that it completes, or 0; the payload stands in `payload()`
    /// until the next byte.
    std::size_t feed(std::uint8_t byte);
    const std::uint8_t* payload() const { return buffer_; }

private:
    std::size_t close();

    std::uint8_t buffer_[max_encoded] = {};
    std::size_t size_ = 0;
    bool is_overlong_ = false;
};

}  // namespace beam

#endif
