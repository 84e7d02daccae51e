// The independent watchdog: the processor is reset where nobody feeds it (RM0090, section 21). Once started it cannot be
// stopped. QEMU does not model it: it is written to, and its flags read 0.

#ifndef BEAM_STM32F405_HARDWARE_WATCHDOG_HPP
#define BEAM_STM32F405_HARDWARE_WATCHDOG_HPP

#include <cstdint>

#include "registers.hpp"
#include "watchdog_counts.hpp"

namespace beam::stm32 {

inline void feed_watchdog() { watchdog().key = 0xAAAA; }

/// Lets the watchdog wait for so many counts; the first call starts it.
inline void begin_watchdog(std::uint32_t counts) {
    constexpr std::uint32_t is_updating = 3;
    // An update takes five counts of the oscillator, 0.3 ms at most; the processor runs at 168 MHz at most.
    constexpr std::uint32_t patience = 50'000;
    watchdog().key = 0xCCCC;
    for (std::uint32_t i = 0; i < patience && (watchdog().status & is_updating) != 0; ++i) {
    }
    watchdog().key = 0x5555;
    watchdog().prescaler = 0;
    watchdog().reload = counts - 1;
    feed_watchdog();
}

}  // namespace beam::stm32

#endif
