// The processor's clocks: what they run at, and the free-running counter that device time is read from.

#ifndef BEAM_STM32F405_CLOCK_HPP
#define BEAM_STM32F405_CLOCK_HPP

#include <cstdint>

namespace beam::stm32 {

constexpr std::uint32_t core_hz = 168'000'000;
/// Of the bus of the first serial port.
constexpr std::uint32_t apb2_hz = 84'000'000;

/// Lets a supply that falls below 2.9 V end in a fault, before the processor's own limit of 1.8 V; false: it is below now.
bool begin_supply_watch();

/// Brings the processor to 168 MHz from a crystal of 25 MHz, and lets the counter run. A crystal that stops later ends in
/// a fault.
///
/// The watchdog runs already, and is fed while crystal and PLL are waited for: a slow crystal (usual are 2 ms) may take its
/// time. Returns false where they do not start within half a second or more; nobody feeds the watchdog then, and it resets. QEMU has no clock controller (all of its registers read
/// 0) and always runs at 168 MHz, but for its timers.
bool begin_clocks();

/// Nanoseconds since `begin_clocks`. It must be read at least every 40 s.
std::uint64_t clock_ns();

/// Returns the time of a reading of timer 2's counter in the last 40 s.
std::uint64_t clock_ns_of(std::uint32_t count);

/// Lets the tick's interrupt come every `period_ns`, a moment after the beginning of a tick.
///
/// Returns false where the timer cannot have that period: whole microseconds up to 99 ms.
bool begin_ticks(std::uint32_t period_ns);

/// Whether time is counted in instructions, by an emulator that goes on only when its plant has answered.
bool is_paced();

}  // namespace beam::stm32

#endif
