#include "serial_port.hpp"

#include "clock.hpp"

namespace beam::stm32 {

namespace {

constexpr std::uint32_t has_overrun = 1U << 3U;
constexpr std::uint32_t has_byte = 1U << 5U;
constexpr std::uint32_t takes_byte = 1U << 7U;
constexpr std::uint32_t receiver = 1U << 2U;
constexpr std::uint32_t sender = 1U << 3U;
constexpr std::uint32_t interrupt_on_byte = 1U << 5U;
constexpr std::uint32_t interrupt_on_room = 1U << 7U;
constexpr std::uint32_t enabled = 1U << 13U;
constexpr std::uint32_t listening = enabled | interrupt_on_byte | sender | receiver;

}  // namespace

void SerialPort::begin(std::uint32_t bus_hz, std::uint32_t baud) {
    registers_.baud = (bus_hz + baud / 2) / baud;
    registers_.control1 = listening;
}

std::size_t SerialPort::read(std::uint8_t* data, std::size_t size, std::uint64_t& begun_ns) {
    std::size_t n = 0;
    bool is_zero = false;
    received_.pop_while([&](std::uint8_t byte) {
        if (n == size || is_zero) {
            return false;
        }
        data[n++] = byte;
        is_zero = byte == 0;
        if (was_between_frames_ && !is_zero) {
            bool is_taken = false;
            beginnings_.pop_while([&](std::uint32_t count) {
                if (is_taken) {
                    return false;
                }
                begun_ = count;
                return is_taken = true;
            });
        }
        was_between_frames_ = is_zero;
        return true;
    });
    begun_ns = clock_ns_of(begun_);
    return n;
}

std::size_t SerialPort::write(const std::uint8_t* data, std::size_t size) {
    const std::size_t n = to_send_.push(data, size);
    // The first bytes go at once; where the port is busy, its interrupt goes on with the rest.
    const Exclusive alone;
    registers_.control1 = listening | interrupt_on_room;
    on_interrupt();
    return n;
}

void SerialPort::on_interrupt() {
    // Reading the status and then the data also clears an overrun; the frame's checksum notices the loss.
    if ((registers_.status & (has_byte | has_overrun)) != 0) {
        const auto byte = static_cast<std::uint8_t>(registers_.data);
        if (received_.push(byte)) {
            if (is_between_frames_ && byte != 0) {
                beginnings_.push(timer2().count);
            }
            is_between_frames_ = byte == 0;
        }
    }
    to_send_.pop_while([this](std::uint8_t byte) {
        if ((registers_.status & takes_byte) == 0) {
            return false;
        }
        registers_.data = byte;
        return true;
    });
    if (to_send_.is_empty()) {
        registers_.control1 = listening;
    }
}

}  // namespace beam::stm32
