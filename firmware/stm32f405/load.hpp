// How much of a tick the firmware works: on hardware in time, under QEMU's -icount in instructions.

#ifndef BEAM_STM32F405_LOAD_HPP
#define BEAM_STM32F405_LOAD_HPP

#include <cstdint>

#include "clock.hpp"

namespace beam::stm32 {

/// From one tick to the next: the time that was not spent waiting. A debugger reads it.
struct Load {
    std::uint64_t ticks = 0;
    std::uint64_t worked_ns = 0;       ///< in all of these ticks
    std::uint64_t most_worked_ns = 0;  ///< in one of them

    std::uint64_t begun_ns = 0;
    std::uint64_t rested_ns = 0;

    /// Ends a tick and begins the next one.
    void turn() {
        const std::uint64_t now_ns = clock_ns();
        const std::uint64_t worked = now_ns - begun_ns - rested_ns;
        if (begun_ns != 0) {
            ++ticks;
            worked_ns += worked;
            most_worked_ns = worked > most_worked_ns ? worked : most_worked_ns;
        }
        begun_ns = now_ns;
        rested_ns = 0;
    }
};

extern Load load;

/// As long as it lives, the firmware waits, or does what only an emulated board has to do.
class Rest {
public:
    Rest() : begun_ns_(clock_ns()) {}
    ~Rest() { load.rested_ns += clock_ns() - begun_ns_; }
    Rest(const Rest&) = delete;
    Rest& operator=(const Rest&) = delete;

private:
    std::uint64_t begun_ns_;
};

}  // namespace beam::stm32

#endif
