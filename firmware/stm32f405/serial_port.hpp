// A serial port behind two rings: its interrupt fills and empties them, the loop does the work.

#ifndef BEAM_STM32F405_SERIAL_PORT_HPP
#define BEAM_STM32F405_SERIAL_PORT_HPP

#include <cstddef>
#include <cstdint>

#include "registers.hpp"

namespace beam::stm32 {

/// A ring with one writer and one reader, of which one may be an interrupt.
template <typename Item, std::size_t size>
class Ring {
    static_assert((size & (size - 1)) == 0, "the size must be a power of two");

public:
    bool push(Item item) {
        if (written_ - read_ == size) {
            return false;
        }
        items_[written_ % size] = item;
        written_ = written_ + 1;
        return true;
    }

    bool pop(Item& item) {
        if (written_ == read_) {
            return false;
        }
        item = items_[read_ % size];
        read_ = read_ + 1;
        return true;
    }

    bool is_empty() const { return written_ == read_; }
    std::size_t room() const { return size - (written_ - read_); }

private:
    // Each index has one writer, and a store of 32 bits is whole: nothing has to be locked.
    volatile std::uint32_t written_ = 0;
    volatile std::uint32_t read_ = 0;
    volatile Item items_[size] = {};
};

class SerialPort {
public:
    explicit SerialPort(SerialRegisters& registers) : registers_(registers) {}

    /// Begins at `baud` bits per second on a bus of `bus_hz`.
    void begin(std::uint32_t bus_hz, std::uint32_t baud);

    /// Takes received bytes up to the end of a frame (a zero byte); returns how many. `begun_ns` is when the frame's
    /// first byte came.
    std::size_t read(std::uint8_t* data, std::size_t size, std::uint64_t& begun_ns);

    /// Takes as many bytes to send as there is room for; returns how many.
    std::size_t write(const std::uint8_t* data, std::size_t size);

    bool has_received() const { return !received_.is_empty(); }

    /// What the port's interrupt must call.
    void on_interrupt();

private:
    SerialRegisters& registers_;
    Ring<std::uint8_t, 4096> received_;
    Ring<std::uint8_t, 8192> to_send_;
    /// Counts of timer 2 when frames began: at most half of the bytes in `received_` follow a zero and are none.
    Ring<std::uint32_t, 2048> beginnings_;
    bool is_between_frames_ = true;
    bool was_between_frames_ = true;
    std::uint32_t begun_ = 0;
};

}  // namespace beam::stm32

#endif
