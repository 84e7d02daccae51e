// A stepper or servo drive with step and direction, a quadrature encoder and switches. Not tried on hardware.
//
//     PA0, PA1   encoder A, B           timer 5 counts it, 32 bits
//     PA2        home switch, high below home; timer 5 latches the count where it changes
//     PA8        step                   timer 1 makes a tick's pulses
//     PB0, PB1   direction (high: +x), enable (high: on)
//     PB4, PB5   end switches at -x, +x (high: hit)
//     PB6        alarm of the drive (high: alarm)
//     PA9, PA10  the host's line
//
// Every input is pulled up, and every switch closes to ground while all is well: a cut wire reads as a hit, an alarm, or
// a hub below home, whose edge is then never found. Between a reset and the first instructions the pins float: PB1 wants
// a resistor to ground outside (docs/firmware.md).

#include <initializer_list>

#include "../plant/default_rig.hpp"
#include "axis.hpp"
#include "pulse_train.hpp"
#include "registers.hpp"

namespace beam::stm32 {

namespace {

constexpr Settings make_settings() {
    Settings settings = default_rig();
    settings.name = "beam firmware, STM32F405";
    settings.step_length = 1e-5;
    return settings;
}

constexpr Settings settings = make_settings();
constexpr std::uint32_t period_ns = settings.period_ns;
static_assert(window_counts(period_ns) <= most_counts, "one pulse in a tick must fit timer 1");
static_assert(steps_needed(settings) <= most_steps(period_ns),
              "at its greatest speed the axis needs more steps in a tick than the drive can tell apart; make steps longer");

constexpr unsigned home_pin = 2;
constexpr unsigned direction_pin = 0;
constexpr unsigned enable_pin = 1;
constexpr unsigned low_end_pin = 4;
constexpr unsigned high_end_pin = 5;
constexpr unsigned alarm_pin = 6;

enum class Use : std::uint32_t { input = 0, output = 1, alternate = 2 };
constexpr std::uint32_t port_a_enable = 1U << 0U;
constexpr std::uint32_t port_b_enable = 1U << 1U;

void pull_up(Port& port, unsigned pin) { port.pull = (port.pull & ~(3U << pin * 2U)) | 1U << pin * 2U; }

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
Timer& encoder() { return at<Timer>(0x40000C00); }

std::uint32_t home_counter = 0;
bool has_home_counter = false;
bool has_lost_steps = false;

}  // namespace

void cut_power() {
    rcc().ahb1_enable |= port_b_enable;
    // A port takes what is written to it two cycles after its clock (RM0090, section 7.3.10): reading back waits for that.
    [[maybe_unused]] const std::uint32_t settled = rcc().ahb1_enable;
    set(port('B'), enable_pin, false);
    use_pin(port('B'), enable_pin, Use::output);
}

Settings begin_axis(std::uint32_t /*boot_id*/) {
    rcc().ahb1_enable |= port_a_enable | port_b_enable;
    rcc().apb1_enable |= 1U << 3U;
    rcc().apb2_enable |= 1U;
    for (unsigned pin : {0U, 1U, home_pin}) {
        pull_up(port('A'), pin);
        use_pin(port('A'), pin, Use::alternate, 2);
    }
    use_pin(port('A'), 8, Use::alternate, 1);
    use_pin(port('B'), direction_pin, Use::output);
    for (unsigned pin : {low_end_pin, high_end_pin, alarm_pin}) {
        pull_up(port('B'), pin);
        use_pin(port('B'), pin, Use::input);
    }

    encoder().slave = encoder_mode;
    encoder().capture_mode[0] = capture_input | capture_input << 8U;
    encoder().capture_mode[1] = capture_input;
    encoder().capture_enable = capture3_both_edges;
    encoder().reload = 0xFFFFFFFFU;
    encoder().control1 = run;

    timer1().prescaler = pulse_prescaler(period_ns);
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
    reading.has_lost_steps = has_lost_steps;
    has_lost_steps = false;
    return reading;
}

void drive(const Drive& drive) {
    set(port('B'), enable_pin, drive.is_powered);
    if (drive.steps == 0) {
        return;
    }
    const auto steps = static_cast<std::uint32_t>(drive.steps > 0 ? drive.steps : -drive.steps);
    // Pulses that still run belong to a tick that was late: those of the next would cut them off. None is made up for.
    if ((timer1().control1 & run) != 0 || steps > most_steps(period_ns)) {
        has_lost_steps = true;
        return;
    }
    set(port('B'), direction_pin, drive.steps > 0);
    const PulseTrain train = pulse_train(period_ns, steps);
    timer1().reload = train.reload;
    timer1().capture[0] = train.compare;
    timer1().repetition = train.repetition;
    // An update takes these over; the timer stops by itself after the last of the pulses.
    timer1().events = 1;
    timer1().control1 = run | once;
}

}  // namespace beam::stm32
