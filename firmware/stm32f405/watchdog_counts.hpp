// How long the independent watchdog waits: numbers only, so that they can be tested anywhere.
//
// It counts an oscillator of its own (LSI), which runs at 17 to 47 kHz and at 32 kHz as a rule, divided by 4.

#ifndef BEAM_STM32F405_WATCHDOG_COUNTS_HPP
#define BEAM_STM32F405_WATCHDOG_COUNTS_HPP

#include <cstdint>

namespace beam::stm32 {

constexpr std::uint32_t fastest_lsi_hz = 47'000;
constexpr std::uint32_t watchdog_divisor = 4;
constexpr std::uint32_t most_watchdog_counts = 1U << 12U;

/// Before the period is known, and at least: 20 ms at 32 kHz, 13.6 to 37.6 ms on any chip.
constexpr std::uint32_t least_watchdog_counts = 160;

/// Counts that even the fastest oscillator takes two ticks for: it is fed once in each.
constexpr std::uint32_t watchdog_counts(std::uint32_t period_ns) {
    const std::uint64_t counts = 2 * std::uint64_t{period_ns} * (fastest_lsi_hz / watchdog_divisor) / 1'000'000'000U + 1;
    return counts > least_watchdog_counts ? static_cast<std::uint32_t>(counts) : least_watchdog_counts;
}

}  // namespace beam::stm32

#endif
