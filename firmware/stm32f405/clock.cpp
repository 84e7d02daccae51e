#include "clock.hpp"

#include "hardware_watchdog.hpp"
#include "registers.hpp"

extern "C" std::uint32_t pacing;

namespace beam::stm32 {

namespace {

constexpr std::uint32_t power_enable = 1U << 28U;
/// The detector at its highest threshold, 2.9 V falling (RM0090, section 5.4.1), and on.
constexpr std::uint32_t detect_2_9_volts = 7U << 5U | 1U << 4U;
constexpr std::uint32_t is_below = 1U << 2U;
/// Its output is line 16 of the external interrupts: high while the supply is below.
constexpr std::uint32_t supply_line = 1U << 16U;
constexpr unsigned supply_interrupt = 1;

/// The clock security system: where the crystal fails, the processor goes on with its own 16 MHz, into the NMI.
constexpr std::uint32_t security_on = 1U << 19U;
constexpr std::uint32_t hse_on = 1U << 16U;
constexpr std::uint32_t hse_ready = 1U << 17U;
constexpr std::uint32_t pll_on = 1U << 24U;
constexpr std::uint32_t pll_ready = 1U << 25U;
/// 25 MHz / 25 * 336 / 2 = 168 MHz, from the crystal; 48 MHz for the random numbers.
constexpr std::uint32_t pll_setting = 25U | 336U << 6U | 0U << 16U | 1U << 22U | 7U << 24U;
/// Buses at 168, 42 and 84 MHz, all from the PLL.
constexpr std::uint32_t bus_setting = 5U << 10U | 4U << 13U | 2U;
constexpr std::uint32_t flash_setting = 5U | 1U << 8U | 1U << 9U | 1U << 10U;
constexpr std::uint32_t timer2_enable = 1U << 0U;

/// How often a flag is looked at: eight cycles or more each time, at 16 MHz half a second.
constexpr std::uint32_t patience = 1'000'000;

constexpr std::uint32_t counts_per_us = 84;
/// QEMU lets every timer run at 1 GHz; a tenth of that wraps as rarely as the real one.
constexpr std::uint32_t emulated_counts_per_us = 100;
constexpr std::uint32_t emulated_prescaler = 9;

/// What stands in memory where an emulator paces the time.
constexpr std::uint32_t paced = 0x50414345;
/// QEMU's idle processor misses every other interrupt of this timer where time is paced; one too many does no harm.
constexpr std::uint32_t paced_interrupts_per_tick = 4;

std::uint32_t rate = counts_per_us;
std::uint64_t counted = 0;

template <typename Condition>
bool wait_until(Condition condition) {
    for (std::uint32_t i = 0; i < patience; ++i) {
        if (condition()) {
            return true;
        }
        feed_watchdog();
    }
    return false;
}

bool begin_pll() {
    rcc().control |= hse_on;
    if (!wait_until([] { return (rcc().control & hse_ready) != 0; })) {
        return false;
    }
    rcc().control |= security_on;
    rcc().pll = pll_setting;
    rcc().control |= pll_on;
    flash_access() = flash_setting;
    if (!wait_until([] { return (rcc().control & pll_ready) != 0; })) {
        return false;
    }
    rcc().configuration = bus_setting;
    return wait_until([] { return (rcc().configuration >> 2U & 3U) == 2U; });
}

}  // namespace

bool begin_supply_watch() {
    rcc().apb1_enable |= power_enable;
    power().control |= detect_2_9_volts;
    external_interrupts().rising |= supply_line;
    external_interrupts().mask |= supply_line;
    // Its handler is the one of every fault; no priority is set, so it is the highest.
    enable_interrupt(supply_interrupt);
    return (power().status & is_below) == 0;
}

bool begin_clocks() {
    const bool is_emulated = rcc().control == 0;
    if (!is_emulated && !begin_pll()) {
        return false;
    }
    rate = is_emulated ? emulated_counts_per_us : counts_per_us;
    rcc().apb1_enable |= timer2_enable;
    timer2().prescaler = is_emulated ? emulated_prescaler : 0;
    if (!is_emulated) {
        // QEMU counts up to 32 bits also without; with it, a paced processor at rest would skip to the overflow.
        timer2().reload = 0xFFFFFFFFU;
    }
    // An update takes prescaler and reload over, and begins at 0.
    timer2().events = 1;
    timer2().control1 = 1;
    return true;
}

std::uint64_t clock_ns() {
    const Exclusive alone;
    counted += timer2().count - static_cast<std::uint32_t>(counted);
    return counted * 1000 / rate;
}

std::uint64_t clock_ns_of(std::uint32_t count) {
    const Exclusive alone;
    counted += timer2().count - static_cast<std::uint32_t>(counted);
    return (counted - (static_cast<std::uint32_t>(counted) - count)) * 1000 / rate;
}

bool begin_ticks(std::uint32_t period_ns) {
    const std::uint64_t cycles = std::uint64_t{period_ns} * (core_hz / 1'000'000U) / 1000;
    if (period_ns % 1000 != 0 || cycles == 0 || cycles > 1U << 24U) {
        return false;
    }
    // The first tick after this moment begins when `period_ns` divides the clock; the timer begins just after it.
    const std::uint64_t begin_ns = (clock_ns() / period_ns + 1) * period_ns;
    system_timer().reload = static_cast<std::uint32_t>(cycles) / (is_paced() ? paced_interrupts_per_tick : 1) - 1;
    while (clock_ns() < begin_ns) {
        feed_watchdog();
    }
    system_timer().count = 0;
    system_timer().control = 7;
    return true;
}

bool is_paced() { return pacing == paced; }

}  // namespace beam::stm32
