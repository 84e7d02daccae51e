// Numbers as bytes, little-endian, as the line protocol has them.

#ifndef BEAM_CORE_WIRE_HPP
#define BEAM_CORE_WIRE_HPP

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <initializer_list>

#include "settings.hpp"
#include "text.hpp"

namespace beam {

static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are copied as they lie in memory");

/// Appends numbers to a buffer that is known to be large enough.
class Writer {
public:
    explicit Writer(std::uint8_t* data) : data_(data) {}

    template <typename Number>
    void put(Number value) {
        std::memcpy(data_ + size_, &value, sizeof value);
        size_ += sizeof value;
    }

    void put(const Limits& limits) {
        for (double value : {limits.travel, limits.max_speed, limits.max_acceleration, limits.max_effort,
                             limits.stop_deceleration, limits.move_speed, limits.move_acceleration,
                             limits.homing_speed, limits.homing_acceleration}) {
            put(value);
        }
        put(limits.watchdog_ns);
    }

    void put(const Text& text) {
        put(text.size());
        std::memcpy(data_ + size_, text.data(), text.size());
        size_ += text.size();
    }

    void put_bytes(const char* bytes, std::size_t n) {
        std::memcpy(data_ + size_, bytes, n);
        size_ += n;
    }

    std::size_t size() const { return size_; }

private:
    std::uint8_t* data_;
    std::size_t size_ = 0;
};

/// Takes numbers from a message; what lies beyond its end is zero, and the message does not fit its type.
class Reader {
public:
    Reader(const std::uint8_t* data, std::size_t size) : data_(data), left_(size) {}

    template <typename Number>
    Number take() {
        Number value{};
        if (left_ < sizeof value) {
            is_short_ = true;
            left_ = 0;
            return value;
        }
        std::memcpy(&value, data_, sizeof value);
        data_ += sizeof value;
        left_ -= sizeof value;
        return value;
    }

    Limits take_limits() {
        Limits limits;
        for (double* value : {&limits.travel, &limits.max_speed, &limits.max_acceleration, &limits.max_effort,
                              &limits.stop_deceleration, &limits.move_speed, &limits.move_acceleration,
                              &limits.homing_speed, &limits.homing_acceleration}) {
            *value = take<double>();
        }
        limits.watchdog_ns = take<std::uint32_t>();
        return limits;
    }

    std::size_t left() const { return left_; }
    bool is_short() const { return is_short_; }
    /// Whether the message was exactly as long as what was taken of it.
    bool is_whole() const { return !is_short_ && left_ == 0; }

private:
    const std::uint8_t* data_;
    std::size_t left_;
    bool is_short_ = false;
};

}  // namespace beam

#endif
