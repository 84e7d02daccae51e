// How much of a tick the firmware works: on hardware in time, under QEMU's -icount in instructions.

#ifndef BEAM_STM32F405_LOAD_HPP
#define BEAM_STM32F405_LOAD_HPP

#include <cstdint>

#include "clock.hpp"

namespace beam::stm32 {

/// The time that was not spent waiting. A debugger reads it.
struct Load {
    std::uint64_t ticks = 0;
    std::uint64_t worked_ns = 0;       ///< from the first tick to the last, with all that lies between them
    std::uint64_t most_worked_ns = 0;  ///< from one tick to the next, at most
    std::uint64_t most_tick_ns = 0;    ///< in a tick itself, at most

    std::uint64_t begun_ns = 0;
    std::uint64_t rested_ns = 0;

    void begin_tick() { begin_ = clock_ns() - rested_ns; }

    /// Ends a tick, and with it the time since the one before.
    void end_tick() {
        const std::uint64_t now_ns = clock_ns();
        most_tick_ns = greater(most_tick_ns, now_ns - rested_ns - begin_);
        if (ticks++ != 0) {
            const std::uint64_t worked = now_ns - begun_ns - rested_ns;
            worked_ns += worked;
            most_worked_ns = greater(most_worked_ns, worked);
        }
        begun_ns = now_ns;
        rested_ns = 0;
    }

private:
    static std::uint64_t greater(std::uint64_t a, std::uint64_t b) { return a < b ? b : a; }

    std::uint64_t begin_ = 0;
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
