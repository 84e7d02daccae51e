// The step pulses of a tick, as timer 1 makes them: numbers only, so that they can be tested anywhere.

#ifndef BEAM_STM32F405_PULSE_TRAIN_HPP
#define BEAM_STM32F405_PULSE_TRAIN_HPP

#include <cstdint>

#include "../core/settings.hpp"

namespace beam::stm32 {

/// What timer 1 counts, before its prescaler.
constexpr std::uint32_t pulse_timer_hz = 168'000'000;
/// Its reload and compare registers have 16 bits, and its repetition counter 8 (RM0090, sections 17.4.12 and 17.4.13).
constexpr std::uint32_t most_counts = 1U << 16U;
constexpr std::uint32_t most_repetitions = 1U << 8U;

/// The direction must stand this long before the first edge of a pulse, and a pulse must be this long: what the slowest
/// of the usual stepper drives ask for (5 us and 2.5 us of the TB6600 and DM542 kind; other kinds want less) [ns].
constexpr std::uint32_t direction_setup_ns = 5000;
constexpr std::uint32_t least_pulse_ns = 2500;

/// A tick's pulses begin when the tick has been calculated, anywhere in its first fifth (docs/firmware.md, budget). So they
/// may take four fifths: they end before those of the next tick begin, and the direction stands that long after them.
constexpr std::uint32_t window_percent = 80;

/// The registers of timer 1 for a tick: pulses of equal spacing, low for its first half and high for its second.
struct PulseTrain {
    std::uint32_t reload = 0;
    std::uint32_t compare = 0;
    std::uint32_t repetition = 0;
};

constexpr std::uint64_t window_ns(std::uint32_t period_ns) { return std::uint64_t{period_ns} * window_percent / 100; }

/// Counts of the undivided timer in the time that a tick's pulses may take.
constexpr std::uint64_t window_cycles(std::uint32_t period_ns) {
    return window_ns(period_ns) * (pulse_timer_hz / 1'000'000U) / 1000;
}

/// The prescaler's register with which one pulse over the whole window fits the timer.
constexpr std::uint32_t pulse_prescaler(std::uint32_t period_ns) {
    return static_cast<std::uint32_t>((window_cycles(period_ns) + most_counts - 1) / most_counts - 1);
}

constexpr std::uint32_t window_counts(std::uint32_t period_ns) {
    return static_cast<std::uint32_t>(window_cycles(period_ns) / (pulse_prescaler(period_ns) + 1));
}

/// As many steps as fit a tick: half of their spacing is the direction's time and the pulse's.
constexpr std::uint32_t most_steps(std::uint32_t period_ns) {
    constexpr std::uint32_t half_ns = direction_setup_ns > least_pulse_ns ? direction_setup_ns : least_pulse_ns;
    const std::uint64_t fitting = window_ns(period_ns) / (2U * half_ns);
    return fitting < most_repetitions ? static_cast<std::uint32_t>(fitting) : most_repetitions;
}

/// The registers for 1 to `most_steps` pulses.
constexpr PulseTrain pulse_train(std::uint32_t period_ns, std::uint32_t steps) {
    const std::uint32_t spacing = window_counts(period_ns) / steps;
    return {spacing - 1, spacing / 2, steps - 1};
}

/// The steps of a tick at the greatest speed, with the one that rounding may add.
constexpr double steps_needed(const Settings& settings) {
    return settings.widest.max_speed * settings.period_ns * 1e-9 / settings.step_length + 1.0;
}

}  // namespace beam::stm32

#endif
