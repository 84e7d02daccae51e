// A stepper or servo drive with step and direction, a quadrature encoder and switches. Not tried on hardware.
//
//     PA0, PA1   encoder A, B           timer 5 counts it, 32 bits
//     PA2        home switch, on below home; timer 5 latches the count where it changes
//     PA8        step                   timer 1 makes a tick's pulses
//     PB0, PB1   direction (high: +x), enable (high: on)
//     PB4, PB5   end switches at -x, +x (high: hit)
//     PB6        alarm of the drive (high: alarm)
//     PA9, PA10  the host's line

#include <initializer_list>

#include "../plant/default_rig.hpp"
#include "axis.hpp"
#include "registers.hpp"

namespace beam::stm32 {

namespace {

constexpr double step_length = 1e-5;
constexpr std::uint32_t most_steps = 256;

constexpr unsigned home_pin = 2;
constexpr unsigned direction_pin = 0;
constexpr unsigned enable_pin = 1;
constexpr unsigned low_end_pin = 4;
constexpr unsigned high_end_pin = 5;
constexpr unsigned alarm_pin = 6;

enum class Use : std::uint32_t { input = 0, output = 1, alternate = 2 };

void use_pin(Port& port, unsigned pin, Use use, std::uint32_t function = 0) {
    port.mode = (port.mode & ~(3U << pin * 2U)) | static_cast<std::uint32_t>(use) << pin * 2U;
    Register& alternate = port.alternate[pin / 8U];
    alternate = (alternate & ~(15U << pin % 8U * 4U)) | function << pin % 8U * 4U;
}

bool is_high(Port& port, unsigned pin) { return (port.input >> pin & 1U) != 0; }

void set(Port& port, unsigned pin, bool is_on) { port.set_reset = 1U << (is_on ? pin : pin + 16U); }

constexpr std::uint32_t encoder_mode = 3;
constexpr std::uint32_t capture_input = 1;
constexpr std::uint32_t capture3_both_edges = 1U << 8U | 1U << 9U | 1U << 11U;
constexpr std::uint32_t has_capture3 = 1U << 3U;
constexpr std::uint32_t active_late = 7U << 4U;
constexpr std::uint32_t output_enable = 1U << 15U;
constexpr std::uint32_t run = 1U;
constexpr std::uint32_t once = 1U << 3U;
/// Timer 1 counts at 42 MHz.
constexpr std::uint32_t pulse_prescaler = 3;
constexpr std::uint32_t counts_per_us = 42;
/// The last pulse of a tick is over before the next tick begins.
constexpr std::uint32_t part_of_tick = 95;

Timer& encoder() { return at<Timer>(0x40000C00); }

std::uint32_t tick_counts = 0;
std::uint32_t home_counter = 0;
bool has_home_counter = false;

}  // namespace

Settings begin_axis(std::uint32_t /*boot_id*/) {
    Settings settings = default_rig();
    settings.name = "beam firmware, STM32F405";
    settings.step_length = step_length;
    tick_counts = settings.period_ns / 1000 * counts_per_us / 100 * part_of_tick;

    rcc().ahb1_enable |= 3U;
    rcc().apb1_enable |= 1U << 3U;
    rcc().apb2_enable |= 1U;
    for (unsigned pin : {0U, 1U, home_pin}) {
        use_pin(port('A'), pin, Use::alternate, 2);
    }
    use_pin(port('A'), 8, Use::alternate, 1);
    for (unsigned pin : {direction_pin, enable_pin}) {
        use_pin(port('B'), pin, Use::output);
    }
    for (unsigned pin : {low_end_pin, high_end_pin, alarm_pin}) {
        use_pin(port('B'), pin, Use::input);
    }

    encoder().slave = encoder_mode;
    encoder().capture_mode[0] = capture_input | capture_input << 8U;
    encoder().capture_mode[1] = capture_input;
    encoder().capture_enable = capture3_both_edges;
    encoder().reload = 0xFFFFFFFFU;
    encoder().control1 = run;

    timer1().prescaler = pulse_prescaler;
    timer1().capture_mode[0] = active_late;
    timer1().capture_enable = 1;
    timer1().break_dead = output_enable;
    return settings;
}

void acknowledge() {}

bool has_reading(std::uint64_t /*tick*/) { return true; }

Reading measure() {
    Reading reading;
    reading.counter = encoder().count;
    if ((encoder().status & has_capture3) != 0) {
        home_counter = encoder().capture[2];
        has_home_counter = true;
    }
    reading.home_counter = home_counter;
    reading.has_home_counter = has_home_counter;
    reading.is_below_home = is_high(port('A'), home_pin);
    reading.is_at_low_end = is_high(port('B'), low_end_pin);
    reading.is_at_high_end = is_high(port('B'), high_end_pin);
    reading.has_drive_alarm = is_high(port('B'), alarm_pin);
    return reading;
}

void drive(const Drive& drive) {
    set(port('B'), enable_pin, drive.is_powered);
    if (drive.steps == 0) {
        return;
    }
    set(port('B'), direction_pin, drive.steps > 0);
    const auto wanted = static_cast<std::uint32_t>(drive.steps > 0 ? drive.steps : -drive.steps);
    const std::uint32_t steps = wanted < most_steps ? wanted : most_steps;
    timer1().reload = tick_counts / steps - 1;
    timer1().capture[0] = tick_counts / steps / 2;
    timer1().repetition = steps - 1;
    // An update takes these over; the timer stops by itself after the last of the pulses.
    timer1().events = 1;
    timer1().control1 = run | once;
}

}  // namespace beam::stm32
