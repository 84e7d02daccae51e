// The processor's clocks: what they run at, and the free-running counter that device time is read from.

#ifndef BEAM_STM32F405_CLOCK_HPP
#define BEAM_STM32F405_CLOCK_HPP

#include <cstdint>

namespace beam::stm32 {

constexpr std::uint32_t core_hz = 168'000'000;
/// Of the bus of the first serial port.
constexpr std::uint32_t apb2_hz = 84'000'000;

/// Brings the processor to 168 MHz from a crystal of 25 MHz, and lets the counter run.
///
/// Returns false where the clocks do not start within their time. QEMU has no clock controller (all of its registers read
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
