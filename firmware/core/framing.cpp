#include "framing.hpp"

#include <array>
#include <cstring>

namespace beam {

namespace {

constexpr std::array<std::uint32_t, 256> make_table() {
    std::array<std::uint32_t, 256> table{};
    for (std::uint32_t byte = 0; byte < 256; ++byte) {
        std::uint32_t rest = byte;
        for (int bit = 0; bit < 8; ++bit) {
            rest = (rest >> 1U) ^ ((rest & 1U) != 0 ? 0xEDB88320U : 0U);
        }
        table[byte] = rest;
    }
    return table;
}

constexpr std::array<std::uint32_t, 256> crc_table = make_table();

/// Writes COBS blocks; a block is a count and up to 254 bytes without a zero.
class CobsWriter {
public:
    explicit CobsWriter(std::uint8_t* out) : out_(out) {}

    void put(std::uint8_t byte) {
        if (run_ == 255) {
            // A full block stands for no zero; where the data end with one, nothing follows it.
            close();
        }
        if (byte == 0) {
            close();
            return;
        }
        out_[size_++] = byte;
        ++run_;
    }

    std::size_t finish() {
        out_[block_] = run_;
        return size_;
    }

private:
    void close() {
        out_[block_] = run_;
        block_ = size_++;
        run_ = 1;
    }

    std::uint8_t* out_;
    std::size_t block_ = 0;
    std::size_t size_ = 1;
    std::uint8_t run_ = 1;
};

}  // namespace

std::uint32_t crc32(const std::uint8_t* data, std::size_t size) {
    std::uint32_t rest = 0xFFFFFFFFU;
    for (std::size_t i = 0; i < size; ++i) {
        rest = (rest >> 8U) ^ crc_table[(rest ^ data[i]) & 0xFFU];
    }
    return rest ^ 0xFFFFFFFFU;
}

std::size_t encode_frame(const std::uint8_t* payload, std::size_t size, std::uint8_t* frame) {
    frame[0] = 0;
    CobsWriter cobs(frame + 1);
    for (std::size_t i = 0; i < size; ++i) {
        cobs.put(payload[i]);
    }
    const std::uint32_t check = crc32(payload, size);
    for (unsigned shift = 0; shift < 32; shift += 8) {
        cobs.put(static_cast<std::uint8_t>(check >> shift));
    }
    const std::size_t end = 1 + cobs.finish();
    frame[end] = 0;
    return end + 1;
}

std::size_t FrameDecoder::feed(std::uint8_t byte) {
    if (byte == 0) {
        return close();
    }
    if (size_ == max_encoded) {
        is_overlong_ = true;
    } else {
        buffer_[size_++] = byte;
    }
    return 0;
}

std::size_t FrameDecoder::close() {
    const std::size_t encoded = is_overlong_ ? 0 : size_;
    size_ = 0;
    is_overlong_ = false;
    // Decoded in place: what has been written never overtakes what is read.
    std::size_t size = 0;
    for (std::size_t place = 0; place < encoded;) {
        const std::size_t code = buffer_[place];
        const std::size_t end = place + code;
        if (end > encoded) {
            return 0;
        }
        std::memmove(buffer_ + size, buffer_ + place + 1, code - 1);
        size += code - 1;
        if (code < 255 && end < encoded) {
            buffer_[size++] = 0;
        }
        place = end;
    }
    if (size < 5) {
        return 0;
    }
    std::uint32_t check = 0;
    std::memcpy(&check, buffer_ + size - 4, 4);
    return crc32(buffer_, size - 4) == check ? size - 4 : 0;
}

}  // namespace beam
