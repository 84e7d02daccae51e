// A serial port behind two rings: its interrupt fills and empties them, the loop does the work.

#ifndef BEAM_STM32F405_SERIAL_PORT_HPP
#define BEAM_STM32F405_SERIAL_PORT_HPP

#include <cstddef>
#include <cstdint>

#include "registers.hpp"

namespace beam::stm32 {

/// A ring with one writer and one reader, of which one may be an interrupt.
template <typename Item, std::uint32_t size>
class Ring {
    static_assert((size & (size - 1)) == 0, "the size must be a power of two");

public:
    /// Takes as many items as there is room for; returns how many.
    std::size_t push(const Item* items, std::size_t n) {
        const std::uint32_t written = written_;
        const std::size_t room = size - (written - read_);
        n = n < room ? n : room;
        for (std::uint32_t i = 0; i < n; ++i) {
            items_[(written + i) % size] = items[i];
        }
        settle();
        written_ = written + static_cast<std::uint32_t>(n);
        return n;
    }
    bool push(Item item) { return push(&item, 1) == 1; }

    /// Hands items to `take` in their order, as long as it returns true.
    template <typename Take>
    void pop_while(Take take) {
        std::uint32_t read = read_;
        const std::uint32_t written = written_;
        settle();
        while (read != written && take(items_[read % size])) {
            ++read;
        }
        settle();
        read_ = read;
    }

    bool is_empty() const { return written_ == read_; }

private:
    /// Nothing that is written before this is written after it: one processor, but its compiler moves things about.
    static void settle() { asm volatile("" ::: "memory"); }

    // Each index has one writer, and a store of 32 bits is whole: nothing has to be locked.
    volatile std::uint32_t written_ = 0;
    volatile std::uint32_t read_ = 0;
    Item items_[size] = {};
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
